/*
 * Step cap: the fraction of a Newton step in which points that keep their size move by no more than a diameter.
 *
 * Where the constraints are dependent, as at rest of a system without drift, Newton's step is unbounded. On spheres and
 * rotations that shows in no residual: all points are as near to one another after any number of turns. So columns of the
 * states whose size is the same along the trajectory, by themselves or as a whole array, are taken to lie on spheres.
 */
#include "search.h"

#include <math.h>
#include <string.h>

/* Times the size of a point, which is the radius of the sphere that it stays on, the farthest motion. */
#define DIAMETER 2.0

/* Points with what each of their coordinates moves them by. */
typedef struct {
    retrax_index points, numbers, dimension;
    const retrax_index *columns, *arrays; /* [numbers] of the entries */
    const double *support;                /* [dimension][numbers] largest entries of frame vectors */
    const double *moves;                  /* coordinates of the steps: those of point i of step k are at */
    retrax_index each, stride, inner;     /* k stride + i inner, where a step has `each` points */
    bool *constant_norm;                         /* [numbers] columns that keep their sizes */
} moving_points;

/* The sum of the squares of the entries of a point that belong to a column, or to an array. */
static double square_of(const moving_points *own, const double *point, const retrax_index *groups, retrax_index group) {
    double sum = 0.0;
    for (retrax_index e = 0; e < own->numbers; e++) {
        sum += groups[e] == group ? point[e] * point[e] : 0.0;
    }
    return sum;
}

/* Whether a group of entries has one size at all points. */
static bool has_constant_norm(const moving_points *own, const double *points, const retrax_index *groups, retrax_index group) {
    double least = INFINITY, most = 0.0;
    for (retrax_index k = 0; k < own->points; k++) {
        const double size = sqrt(square_of(own, points + k * own->numbers, groups, group));
        least = fmin(least, size);
        most = fmax(most, size);
    }
    return most - least <= RETRAX_ROOT_EPS * most;
}

/* Whether a group of entries has the sizes at all points that it had before. */
static bool is_kept(const moving_points *own, const double *before, const double *after, const retrax_index *groups,
                    retrax_index group) {
    for (retrax_index k = 0; k < own->points; k++) {
        const double size = sqrt(square_of(own, before + k * own->numbers, groups, group));
        const double now = sqrt(square_of(own, after + k * own->numbers, groups, group));
        if (!(fabs(now - size) <= RETRAX_ROOT_EPS * size)) {
            return false;
        }
    }
    return true;
}

/* Whether coordinate a moves columns of constant norm of an array and nothing else. */
static bool moves_alone(const moving_points *own, retrax_index a, retrax_index array) {
    bool touches = false;
    for (retrax_index e = 0; e < own->numbers; e++) {
        if (own->support[a * own->numbers + e] > RETRAX_ROOT_EPS) {
            if (own->arrays[e] != array || !own->constant_norm[own->columns[e]]) {
                return false;
            }
            touches = true;
        }
    }
    return touches;
}

/* The largest motion of an array of the points relative to the size of its columns of constant norm. */
static double farthest_motion(const moving_points *own, const double *points) {
    double farthest = 0.0;
    for (retrax_index array = 0; array < own->numbers; array++) {
        double length = 0.0, size = 0.0;
        for (retrax_index k = 0; k < own->points; k++) {
            double moved = 0.0, square = 0.0;
            for (retrax_index a = 0; a < own->dimension; a++) {
                const double move = own->moves[k / own->each * own->stride + k % own->each * own->inner + a];
                moved += moves_alone(own, a, array) ? move * move : 0.0;
            }
            for (retrax_index e = 0; e < own->numbers; e++) {
                const double entry = points[k * own->numbers + e];
                square += own->arrays[e] == array && own->constant_norm[own->columns[e]] ? entry * entry : 0.0;
            }
            length = fmax(length, moved);
            size = fmax(size, square);
        }
        farthest = fmax(farthest, size > 0.0 ? sqrt(length / size) : 0.0);
    }
    return farthest;
}

/* Whether no coordinate moves by its share of a diameter, but for those that move nothing but arrays that are zero all
 * along, as rates at rest: then nothing else is to be found out. */
static bool all_small(const retrax_layout *layout, const double *trajectory, const double *largest) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index n = problem->state_size, E = problem->state_numbers;
    for (retrax_index a = 0; a < n; a++) {
        double size = 0.0, array = 0.0;
        for (retrax_index e = 0; e < E; e++) {
            const double share = ARRAY(SUPPORT)[a * E + e];
            size = fmax(size, share * fmax(ARRAY(HIGHEST)[e], ARRAY(LOWEST)[e]));
            for (retrax_index f = 0; f < E && share > 0.0; f++) {
                if (problem->arrays[f] == problem->arrays[e]) {
                    array = fmax(array, fmax(ARRAY(HIGHEST)[f], ARRAY(LOWEST)[f]));
                }
            }
        }
        if (largest[a] > DIAMETER / sqrt((double)n) * size && array > 0.0) {
            return false;
        }
    }
    return true;
}

/* Marks the columns that keep their sizes along the trajectory, by themselves or as a whole array. */
static void mark_constant_norm(moving_points *own, const double *points) {
    memset(own->constant_norm, 0, sizeof(bool) * (size_t)own->numbers);
    for (retrax_index e = 0; e < own->numbers; e++) {
        own->constant_norm[own->columns[e]] = has_constant_norm(own, points, own->columns, own->columns[e]) ||
                                       has_constant_norm(own, points, own->arrays, own->arrays[e]);
    }
}

/* Of these, keeps those that have the sizes that they had. */
static void mark_kept(moving_points *own, const double *before, const double *after) {
    for (retrax_index e = 0; e < own->numbers; e++) {
        own->constant_norm[own->columns[e]] =
            own->constant_norm[own->columns[e]] && (is_kept(own, before, after, own->columns, own->columns[e]) ||
                                             is_kept(own, before, after, own->arrays, own->arrays[e]));
    }
}

/* Writes the largest entries of the frames at the controls. */
static void write_control_support(const retrax_layout *layout, double *trajectory) {
    const retrax_index size = layout->problem->control_size * layout->problem->control_numbers;
    memset(ARRAY(CONTROL_SUPPORT), 0, sizeof(double) * (size_t)size);
    for (retrax_index i = 0; i < layout->count[RETRAX_ARRAY_CONTROL_FRAMES]; i++) {
        double *const found = ARRAY(CONTROL_SUPPORT) + i % size;
        *found = retrax_larger(*found, fabs(ARRAY(CONTROL_FRAMES)[i]));
    }
}

double retrax_step_cap(const retrax_layout *layout, double *trajectory, const double *largest, double *trial,
                       bool *constant_norm) {
    const retrax_problem *const problem = layout->problem;
    const retrax_index E = problem->state_numbers, n = problem->state_size, m = problem->control_size;
    const retrax_index z = layout->count[RETRAX_ARRAY_PARTS], s = problem->points;
    static const retrax_array arrays[] = {RETRAX_ARRAY_CENTRES, RETRAX_ARRAY_CONTROLS};
    moving_points parts[] = {{problem->steps, E, n, problem->columns, problem->arrays, ARRAY(SUPPORT), ARRAY(STEPS), 1, z,
                              0, constant_norm},
                             {problem->steps * s, problem->control_numbers, m, problem->control_columns,
                              problem->control_arrays, ARRAY(CONTROL_SUPPORT), ARRAY(STEPS) + n, s, z, m, constant_norm + E}};
    const int count = problem->curved_controls ? 2 : 1;
    double farthest = 0.0, kept = 0.0;
    if (problem->curved_controls) {
        write_control_support(layout, trajectory);
    } else if (all_small(layout, trajectory, largest)) {
        return 1.0;
    }
    for (int i = 0; i < count; i++) {
        mark_constant_norm(&parts[i], trajectory + layout->first[arrays[i]]);
        farthest = fmax(farthest, farthest_motion(&parts[i], trajectory + layout->first[arrays[i]]));
    }
    if (!(farthest > DIAMETER)) {
        return 1.0;
    }
    retrax_move_trajectory(layout, trajectory, DIAMETER / farthest, trial);
    for (int i = 0; i < count; i++) {
        const double *const before = trajectory + layout->first[arrays[i]];
        mark_kept(&parts[i], before, trial + layout->first[arrays[i]]);
        kept = fmax(kept, farthest_motion(&parts[i], before));
    }
    return DIAMETER / fmax(kept, DIAMETER);
}
