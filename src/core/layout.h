/*
 * Layout: where the arrays of a trajectory stand, for the files that work on them.
 *
 * All arrays of a trajectory stand in one block of numbers. So a function of the problem reads and writes them where they
 * are, and its places are set once for all trajectories of the problem.
 */
#ifndef RETRAX_LAYOUT_H
#define RETRAX_LAYOUT_H

#include "retrax_core.h"

#include <stdbool.h>

/* The address of an array of a trajectory, where `layout` and `trajectory` have these names. */
#define ARRAY(name) (trajectory + layout->first[RETRAX_ARRAY_##name])

/* Whether the method of a problem is a collocation method, and not a discretization map. */
bool retrax_collocates(const retrax_problem *problem);

/* Bytes of workspace of retrax_measure_scale; 0 if it exceeds the address space. */
size_t retrax_scaling_workspace(const retrax_problem *problem);

#endif /* RETRAX_LAYOUT_H */
