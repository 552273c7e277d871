// Takes all that waits in a queue: what the next dispatch's workgroups are for, and how many of them there are.

@group(0) @binding(0) var<storage, read_write> queue: SourceQueue;
@group(0) @binding(1) var<storage, read_write> workgroups: array<u32, 3>;

@compute @workgroup_size(1)
fn sources_taken_main() {
    let count = atomicExchange(&queue.waiting, 0u);
    queue.taken = count;
    workgroups[0] = min(count, SOURCES_MANY_COLUMNS);
    workgroups[1] = (count + SOURCES_MANY_COLUMNS - 1u) / SOURCES_MANY_COLUMNS;
    workgroups[2] = 1u;
}
