// Visibility bitmaps by Embree's coherent occlusion packets, for comparison.
//
//   c++ -std=c++17 -O2 -o occluded occluded.cpp -lembree3 -pthread
//
// With -DEMBREE_4 and the library of Embree 4 in its place: README.md.
//
//   occluded RAYS [--threads N] [--robust] [--bitmaps OUT] < one line per round
//
// Reads RAYS (README.md has its format), builds a scene, and for every line of standard
// input shoots every direction from every origin and prints one JSON object as a line.

#ifdef EMBREE_4
// Nothing here differs between the two but this call, whose new form is declared below.
#define rtcOccluded16 rtcOccluded16_of_3
#endif
#include <embree3/rtcore.h>
#undef rtcOccluded16
#include <pmmintrin.h>
#include <xmmintrin.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iostream>
#include <limits>
#include <string>
#include <thread>
#include <vector>

namespace {

using Clock = std::chrono::steady_clock;

struct Vector {
    float x, y, z;
};

struct Input {
    uint32_t resolution = 0;
    std::vector<Vector> directions, triangles, origins;
};

[[noreturn]] void fail(const std::string &message) {
    std::fprintf(stderr, "error: %s\n", message.c_str());
    std::exit(1);
}

double seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

Input read(const char *path) {
    std::ifstream file(path, std::ios::binary);
    char magic[8];
    uint32_t counts[4];
    file.read(magic, sizeof magic);
    file.read(reinterpret_cast<char *>(counts), sizeof counts);
    if (!file || std::memcmp(magic, "RAYPEER1", 8) != 0)
        fail(std::string(path) + ": expected a RAYPEER1 file");
    Input input;
    input.resolution = counts[0];
    if (input.resolution % 4 != 0 || input.resolution > 4096)
        fail(std::string(path) + ": expected a resolution that is a multiple of 4");
    const auto vectors = [&](std::vector<Vector> &to, size_t count) {
        to.resize(count);
        file.read(reinterpret_cast<char *>(to.data()), std::streamsize(count * sizeof(Vector)));
        if (!file) fail(std::string(path) + ": ends early");
    };
    vectors(input.directions, size_t(input.resolution) * input.resolution);
    vectors(input.triangles, size_t(counts[1]) * 3);
    vectors(input.origins, counts[2]);
    return input;
}

RTCScene build(RTCDevice device, const Input &input, bool robust) {
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
    rtcSetSceneFlags(scene, robust ? RTC_SCENE_FLAG_ROBUST : RTC_SCENE_FLAG_NONE);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    const size_t corners = input.triangles.size();
    void *vertices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0,
                                             RTC_FORMAT_FLOAT3, sizeof(Vector), corners);
    std::memcpy(vertices, input.triangles.data(), corners * sizeof(Vector));
    auto *indices = static_cast<uint32_t *>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                3 * sizeof(uint32_t), corners / 3));
    for (size_t i = 0; i < corners; ++i) indices[i] = uint32_t(i);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene);
    return scene;
}

#ifdef EMBREE_4
}  // namespace

// As in Embree 4's rtcore_common.h and rtcore_scene.h.
struct RTCOccludedArguments {
    int flags;
    int feature_mask;
    void *context;
    void *filter;
    void *occluded;
};
extern "C" void rtcOccluded16(const int *valid, RTCScene scene, RTCRay16 *rays,
                              RTCOccludedArguments *arguments);

namespace {

constexpr int coherent = 1 << 16;
constexpr int all_features = -1;
#endif

// Shoots all directions from one origin, in packets of 4x4 texels. Sets bits where visible
// and returns the number of occluded texels.
uint32_t shoot(RTCScene scene, const Input &input, Vector origin, uint8_t *bitmap) {
#ifdef EMBREE_4
    RTCOccludedArguments arguments = {coherent, all_features, nullptr, nullptr, nullptr};
#else
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
#endif
    alignas(64) static const int valid[16] = {-1, -1, -1, -1, -1, -1, -1, -1,
                                              -1, -1, -1, -1, -1, -1, -1, -1};
    const uint32_t n = input.resolution;
    uint32_t occluded = 0;
    alignas(64) RTCRay16 rays;
    for (uint32_t row = 0; row < n; row += 4)
        for (uint32_t column = 0; column < n; column += 4) {
            for (uint32_t i = 0; i < 16; ++i) {
                const Vector &d = input.directions[(row + i / 4) * n + column + i % 4];
                rays.org_x[i] = origin.x;
                rays.org_y[i] = origin.y;
                rays.org_z[i] = origin.z;
                rays.dir_x[i] = d.x;
                rays.dir_y[i] = d.y;
                rays.dir_z[i] = d.z;
                rays.tnear[i] = 0;
                rays.tfar[i] = std::numeric_limits<float>::infinity();
                rays.time[i] = 0;
                rays.mask[i] = ~0u;
                rays.flags[i] = 0;
            }
#ifdef EMBREE_4
            rtcOccluded16(valid, scene, &rays, &arguments);
#else
            rtcOccluded16(valid, scene, &context, &rays);
#endif
            for (uint32_t i = 0; i < 16; ++i) {
                const bool hit = rays.tfar[i] < 0;
                occluded += hit;
                const uint32_t texel = (row + i / 4) * n + column + i % 4;
                if (!hit) bitmap[texel / 8] |= uint8_t(1u << (texel % 8));
            }
        }
    return occluded;
}

}  // namespace

int main(int argc, char **argv) {
    const char *path = nullptr, *bitmap_path = nullptr;
    unsigned threads = 2;
    bool robust = false;
    for (int i = 1; i < argc; ++i) {
        const std::string argument = argv[i];
        if (argument == "--robust")
            robust = true;
        else if (argument == "--threads" && i + 1 < argc)
            threads = unsigned(std::max(1, std::atoi(argv[++i])));
        else if (argument == "--bitmaps" && i + 1 < argc)
            bitmap_path = argv[++i];
        else if (path == nullptr)
            path = argv[i];
        else
            fail("unknown argument " + argument);
    }
    if (path == nullptr) fail("usage: occluded RAYS [--threads N] [--robust] [--bitmaps OUT]");
    const Input input = read(path);

    const std::string configuration = "threads=" + std::to_string(threads);
    RTCDevice device = rtcNewDevice(configuration.c_str());
    if (device == nullptr) fail("Embree does not start");
    const auto property = [&](RTCDeviceProperty name) {
        return std::to_string(rtcGetDeviceProperty(device, name));
    };
    const std::string version = property(RTC_DEVICE_PROPERTY_VERSION_MAJOR) + "." +
                                property(RTC_DEVICE_PROPERTY_VERSION_MINOR);
    const auto build_start = Clock::now();
    RTCScene scene = build(device, input, robust);
    const double build_seconds = seconds_since(build_start);
    const size_t bytes = size_t(input.resolution) * input.resolution / 8;
    std::vector<uint8_t> bitmaps;

    for (std::string line; std::getline(std::cin, line);) {
        bitmaps.assign(input.origins.size() * bytes, 0);
        std::atomic<size_t> next{0};
        std::atomic<uint64_t> occluded{0};
        const auto start = Clock::now();
        std::vector<std::thread> workers;
        for (unsigned t = 0; t < threads; ++t)
            workers.emplace_back([&] {
                // As Embree's manual asks.
                _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
                _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
                uint64_t sum = 0;
                for (size_t i; (i = next++) < input.origins.size();)
                    sum += shoot(scene, input, input.origins[i], &bitmaps[i * bytes]);
                occluded += sum;
            });
        for (std::thread &worker : workers) worker.join();
        const double seconds = seconds_since(start);
        const double rays = double(input.origins.size()) * double(input.directions.size());
        std::printf("{\"version\": \"%s\", \"robust\": %s, \"threads\": %u, "
                    "\"build_seconds\": %.6f, \"seconds\": %.6f, \"rays\": %.0f, "
                    "\"occluded\": %llu, \"megarays_per_second\": %.3f}\n",
                    version.c_str(), robust ? "true" : "false", threads, build_seconds,
                    seconds, rays, static_cast<unsigned long long>(occluded.load()),
                    rays / seconds * 1e-6);
        std::fflush(stdout);
    }
    if (bitmap_path != nullptr) {
        std::ofstream file(bitmap_path, std::ios::binary);
        file.write(reinterpret_cast<const char *>(bitmaps.data()),
                   std::streamsize(bitmaps.size()));
        file.close();
        if (!file) fail(std::string(bitmap_path) + ": cannot write");
    }
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
}
