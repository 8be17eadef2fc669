/*
 * Workspace: arrays one after the other in one block of memory.
 *
 * The function that lays out the arrays of a workspace is called twice: with a block whose base is NULL, to learn its
 * size, and with the memory that the caller has then provided. So sizes and places have one writer.
 */
#ifndef RETRAX_WORKSPACE_H
#define RETRAX_WORKSPACE_H

#include "retrax_core.h"

/* Bytes that arrays are aligned to: a cache line, and a vector of AVX-512. */
#define RETRAX_ALIGNMENT 64

/* A block of memory, of which `used` bytes are taken. */
typedef struct {
    unsigned char *base; /* NULL: only sizes count */
    size_t used;         /* SIZE_MAX where the arrays do not fit the address space */
} retrax_block;

/* Takes rows * columns items of some bytes from a block; returns their address, NULL if the block has no memory. */
static inline void *retrax_take(retrax_block *block, retrax_index rows, retrax_index columns, size_t bytes) {
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

#endif /* RETRAX_WORKSPACE_H */
