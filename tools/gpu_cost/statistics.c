// statistics FILE ENTRY SET.BINDING.TYPE...: what a driver tells of a compute pipeline, a line each:
// name, tab, value. TYPE: u uniform buffer, s storage buffer, t sampled texture, p sampler, w storage
// texture.
#include <stdio.h>
#include <stdlib.h>
#include <vulkan/vulkan.h>

enum { SETS = 4, BINDINGS = 32, STATISTICS = 64 };

static void require(VkResult result, const char *step) {
    if (result != VK_SUCCESS) {
        fprintf(stderr, "%s: VkResult %d\n", step, result);
        exit(1);
    }
}

static VkDescriptorType descriptor(char letter) {
    switch (letter) {
    case 'u': return VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER;
    case 's': return VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
    case 't': return VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE;
    case 'p': return VK_DESCRIPTOR_TYPE_SAMPLER;
    case 'w': return VK_DESCRIPTOR_TYPE_STORAGE_IMAGE;
    default: fprintf(stderr, "binding of type %c\n", letter); exit(2);
    }
}

static VkDevice open_device(void) {
    VkApplicationInfo application = {.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO, .apiVersion = VK_API_VERSION_1_2};
    VkInstanceCreateInfo with = {.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO, .pApplicationInfo = &application};
    VkInstance instance;
    require(vkCreateInstance(&with, NULL, &instance), "vkCreateInstance");
    uint32_t count = 1;
    VkPhysicalDevice physical;
    VkResult found = vkEnumeratePhysicalDevices(instance, &count, &physical);
    require(found == VK_INCOMPLETE ? VK_SUCCESS : found, "vkEnumeratePhysicalDevices");
    if (count == 0) {
        fprintf(stderr, "no device\n");
        exit(1);
    }
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(physical, &properties);
    printf("device\t%s\n", properties.deviceName);

    float priority = 1.0f;
    VkDeviceQueueCreateInfo queue = {
        .sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO, .queueCount = 1, .pQueuePriorities = &priority};
    const char *extension = VK_KHR_PIPELINE_EXECUTABLE_PROPERTIES_EXTENSION_NAME;
    VkPhysicalDevicePipelineExecutablePropertiesFeaturesKHR executables = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PIPELINE_EXECUTABLE_PROPERTIES_FEATURES_KHR,
        .pipelineExecutableInfo = VK_TRUE};
    // naga's modules ask for the Vulkan memory model from SPIR-V 1.5 on.
    VkPhysicalDeviceVulkanMemoryModelFeatures memory = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_MEMORY_MODEL_FEATURES,
        .pNext = &executables, .vulkanMemoryModel = VK_TRUE, .vulkanMemoryModelDeviceScope = VK_TRUE};
    VkPhysicalDeviceFeatures features;
    vkGetPhysicalDeviceFeatures(physical, &features);
    VkDeviceCreateInfo device_with = {
        .sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO, .pNext = &memory,
        .queueCreateInfoCount = 1, .pQueueCreateInfos = &queue,
        .enabledExtensionCount = 1, .ppEnabledExtensionNames = &extension, .pEnabledFeatures = &features};
    VkDevice device;
    require(vkCreateDevice(physical, &device_with, NULL, &device), "vkCreateDevice");
    return device;
}

static VkShaderModule read_module(VkDevice device, const char *path) {
    FILE *file = fopen(path, "rb");
    if (!file || fseek(file, 0, SEEK_END)) {
        perror(path);
        exit(1);
    }
    long size = ftell(file);
    rewind(file);
    uint32_t *words = malloc(size > 0 ? (size_t)size : 1);
    if (size <= 0 || !words || fread(words, 1, (size_t)size, file) != (size_t)size) {
        fprintf(stderr, "%s: cannot be read\n", path);
        exit(1);
    }
    fclose(file);
    VkShaderModuleCreateInfo with = {
        .sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO, .codeSize = (size_t)size, .pCode = words};
    VkShaderModule module;
    require(vkCreateShaderModule(device, &with, NULL, &module), "vkCreateShaderModule");
    free(words);
    return module;
}

static VkPipelineLayout make_layout(VkDevice device, int count, char **bindings) {
    VkDescriptorSetLayoutBinding of_set[SETS][BINDINGS];
    uint32_t lengths[SETS] = {0};
    for (int i = 0; i < count; i++) {
        unsigned set, binding;
        char type;
        if (sscanf(bindings[i], "%u.%u.%c", &set, &binding, &type) != 3 || set >= SETS || lengths[set] == BINDINGS) {
            fprintf(stderr, "binding %s\n", bindings[i]);
            exit(2);
        }
        of_set[set][lengths[set]++] = (VkDescriptorSetLayoutBinding){
            .binding = binding, .descriptorType = descriptor(type), .descriptorCount = 1,
            .stageFlags = VK_SHADER_STAGE_COMPUTE_BIT};
    }
    VkDescriptorSetLayout sets[SETS];
    for (int set = 0; set < SETS; set++) {
        VkDescriptorSetLayoutCreateInfo with = {
            .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO,
            .bindingCount = lengths[set], .pBindings = of_set[set]};
        require(vkCreateDescriptorSetLayout(device, &with, NULL, &sets[set]), "vkCreateDescriptorSetLayout");
    }
    VkPipelineLayoutCreateInfo with = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO, .setLayoutCount = SETS, .pSetLayouts = sets};
    VkPipelineLayout layout;
    require(vkCreatePipelineLayout(device, &with, NULL, &layout), "vkCreatePipelineLayout");
    return layout;
}

static void print_value(const VkPipelineExecutableStatisticKHR *statistic) {
    switch (statistic->format) {
    case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_FLOAT64_KHR:
        printf("%s\t%.0f\n", statistic->name, statistic->value.f64);
        break;
    case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_INT64_KHR:
        printf("%s\t%lld\n", statistic->name, (long long)statistic->value.i64);
        break;
    default:
        printf("%s\t%llu\n", statistic->name, (unsigned long long)statistic->value.u64);
    }
}

int main(int argc, char **argv) {
    if (argc < 3) {
        fprintf(stderr, "statistics FILE ENTRY SET.BINDING.TYPE...\n");
        return 2;
    }
    VkDevice device = open_device();
    VkComputePipelineCreateInfo with = {
        .sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO,
        .flags = VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR,
        .stage = {
            .sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO, .stage = VK_SHADER_STAGE_COMPUTE_BIT,
            .module = read_module(device, argv[1]), .pName = argv[2]},
        .layout = make_layout(device, argc - 3, argv + 3)};
    VkPipeline pipeline;
    require(vkCreateComputePipelines(device, VK_NULL_HANDLE, 1, &with, NULL, &pipeline), "vkCreateComputePipelines");

    PFN_vkGetPipelineExecutableStatisticsKHR read = (PFN_vkGetPipelineExecutableStatisticsKHR)vkGetDeviceProcAddr(
        device, "vkGetPipelineExecutableStatisticsKHR");
    if (!read) {
        fprintf(stderr, "the driver tells nothing of pipelines\n");
        return 1;
    }
    VkPipelineExecutableInfoKHR which = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_INFO_KHR, .pipeline = pipeline};
    VkPipelineExecutableStatisticKHR statistics[STATISTICS] = {0};
    for (int i = 0; i < STATISTICS; i++) {
        statistics[i].sType = VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_STATISTIC_KHR;
    }
    uint32_t count = STATISTICS;
    require(read(device, &which, &count, statistics), "vkGetPipelineExecutableStatisticsKHR");
    for (uint32_t i = 0; i < count; i++) {
        print_value(&statistics[i]);
    }
    return 0;
}
