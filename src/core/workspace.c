/* Workspace: arrays one after the other in one block of memory. */
#include "workspace.h"

void *retrax_take(retrax_block *block, retrax_index rows, retrax_index columns, size_t bytes) {
    const size_t most = SIZE_MAX / 4;
    const size_t count = (size_t)rows, each = (size_t)columns;
    if (block->used == SIZE_MAX || (each > 0 && count > most / each) || count * each > most / bytes ||
        block->used > most) {
        block->used = SIZE_MAX;
        return NULL;
    }
    void *const found = block->base == NULL ? NULL : (void *)(block->base + block->used);
    block->used += (count * each * bytes + RETRAX_ALIGNMENT - 1) & ~(size_t)(RETRAX_ALIGNMENT - 1);
    return found;
}
