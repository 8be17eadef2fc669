/*
 * Random numbers for the drivers that run under sanitizers and valgrind: soft ones in [-1, 1), and hard ones.
 */
#ifndef RETRAX_FUZZ_H
#define RETRAX_FUZZ_H

#include "../../src/core/retrax_core.h"

#include <math.h>

typedef struct {
    uint64_t state;
    int hard; /* one of so many numbers is hard, none if 0 */
} generator;

static uint64_t draw(generator *g) { /* xorshift64* [Vigna 2016] */
    g->state ^= g->state >> 12;
    g->state ^= g->state << 25;
    g->state ^= g->state >> 27;
    return g->state * 2685821657736338717u;
}

static retrax_index below(generator *g, retrax_index end) { return (retrax_index)(draw(g) >> 33) % end; }

static double number(generator *g) {
    static const double hard[] = {0.0,  -0.0,  1.0,    -1.0,   INFINITY, -INFINITY, NAN,
                                  0.5,  -2.5,  1e308,  -1e308, 5e-324,   1e-160};
    const double soft = (double)(draw(g) >> 11) / 4503599627370496.0 - 1.0;
    return g->hard > 0 && below(g, g->hard) == 0 ? hard[below(g, 13)] : soft;
}

#endif
