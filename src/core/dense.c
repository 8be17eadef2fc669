/* Dense linear algebra: symmetric indefinite fronts, and whether a matrix is positive definite. */
#include "dense.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

/* A number of this size is zero, but for rounding, rows being scaled to one size. */
#define NOTHING 1e-15
/* A right-hand side of this size, in units of the scaling, is zero but for rounding: 64 eps. */
#define CONSISTENT 1.4210854715202004e-14
/* Share of the entries of the border that a pivot has to exceed, or its row is left: of what it is subtracted from no
 * more than so many digits are lost. */
#define STABLE 1e-3
/* A diagonal entry of this share of the largest entry in its row is a pivot of size one: so the growth by one pivot of
 * size two is bounded as by two of size one, (1 + sqrt(17)) / 8 [Bunch, Kaufman, Math. Comp. 31, 1977]. */
#define BUNCH_KAUFMAN 0.6403882032022076

retrax_index retrax_width(retrax_index columns) {
    return (columns + RETRAX_VECTOR - 1) & -(retrax_index)RETRAX_VECTOR;
}

void retrax_take_front(retrax_block *block, retrax_index rows, retrax_index width, retrax_front *front) {
    front->width = width;
    front->matrix = retrax_take(block, rows, width, sizeof(double));
    front->left = retrax_take(block, 1, width, sizeof(double));
    front->sizes = retrax_take(block, 1, width, sizeof(double));
    front->kept = retrax_take(block, rows, width, sizeof(double));
    front->known = retrax_take(block, rows, 1, sizeof(retrax_index));
    front->unstable = retrax_take(block, rows, 1, sizeof(bool));
}

void retrax_add_inertia(retrax_inertia *to, retrax_inertia own) {
    to->negative += own.negative;
    to->smallest = own.smallest < to->smallest || isnan(own.smallest) ? own.smallest : to->smallest;
}

bool retrax_is_positive_definite(const double *a, retrax_index m, retrax_index stride, double more, double *work) {
    for (retrax_index i = 0; i < m; i++) {
        memcpy(work + i * m, a + i * stride, sizeof(double) * (size_t)m);
    }
    for (retrax_index i = 0; i < m; i++) {
        const double pivot = work[i * m + i] + more;
        if (!(pivot > 0.0)) {
            return false;
        }
        for (retrax_index j = i + 1; j < m; j++) {
            for (retrax_index k = j; k < m; k++) {
                work[j * m + k] -= work[i * m + j] * work[i * m + k] / pivot;
            }
        }
    }
    return true;
}

/* ------------------------------------------------------------------------------- symmetric indefinite fronts */

/* A search for the next pivot: the front, how many pivots it has by now, and the first row that is left. */
typedef struct {
    const retrax_kernels *kernels;
    retrax_front *front;
    retrax_pivots *found;
    retrax_index pivots; /* rows to eliminate */
    retrax_index count;  /* rows that are eliminated */
    retrax_index first;  /* first row that is left */
    retrax_index begin;  /* the same, down to a whole vector: what stands before it in a row is of no use */
} search;

/* A pivot: rows i and r, equal for one of size one, and the size of its smaller eigenvalue. */
typedef struct {
    retrax_index i, r;
    double size;
} pivot;

static double *row_of(const retrax_front *front, retrax_index i) { return front->matrix + i * front->width; }

/* Subtracts from row r the pivots that have not been subtracted yet; returns the largest size beside the diagonal
 * among the rows that are left. Sizes of all entries, 0 where no pivot can be, are in front->sizes. */
static double update_row(const search *own, retrax_index r) {
    retrax_front *const front = own->front;
    const retrax_index width = front->width, known = front->known[r], begin = own->begin;
    double *const row = row_of(front, r);
    own->kernels->subtract_products(1, width - begin, own->count - known, row + begin, width,
                                    own->found->divided + known * width + r, width, front->kept + known * width + begin,
                                    width);
    front->known[r] = own->count;
    front->left[r] = 0.0;
    const double largest = own->kernels->masked_sizes(retrax_width(own->pivots) - begin, front->sizes + begin,
                                                      front->left + begin, row + begin);
    front->left[r] = 1.0;
    return largest;
}

/* The largest entry of row i in the border. */
static double border_size(const search *own, retrax_index i) {
    double largest = 0.0;
    for (retrax_index a = own->pivots; a < own->front->rows; a++) {
        const double size = fabs(row_of(own->front, i)[a]);
        largest = size > largest ? size : largest;
    }
    return largest;
}

/* First row among those left with an entry of this size in the row that was updated last; `otherwise` if there is
 * none. */
static retrax_index place_of(const search *own, double size, retrax_index otherwise) {
    for (retrax_index j = own->first; j < own->pivots; j++) {
        if (own->front->sizes[j] == size) {
            return j;
        }
    }
    return otherwise;
}

/* Chooses the next pivot, beginning with row i: rows i and r, equal for a pivot of size one. The search goes from row
 * to row with a larger entry each time, so it ends. */
static void choose_pivot(const search *own, retrax_index *i, retrax_index *r) {
    double size = 0.0;
    *r = *i;
    for (;;) {
        const double largest = update_row(own, *r);
        if (fabs(row_of(own->front, *r)[*r]) >= BUNCH_KAUFMAN * largest) {
            *i = *r;
            return;
        }
        if (!(largest > size)) {
            return; /* the largest entry of both rows, or NaN */
        }
        const retrax_index other = place_of(own, largest, *r);
        if (other == *i) {
            return; /* rounding in one of the rows differs from the other's */
        }
        *i = *r;
        *r = other;
        size = largest;
    }
}

/* Keeps row i as it is and divided by its pivot. */
static void keep_one(search *own, retrax_index i) {
    const retrax_index width = own->front->width, begin = own->begin, columns = width - begin;
    const double *const x = row_of(own->front, i) + begin;
    double *const kept = own->front->kept + own->count * width, *const divided = own->found->divided + own->count * width;
    memcpy(kept + begin, x, sizeof(double) * (size_t)columns);
    own->kernels->scale(columns, divided + begin, 1.0 / x[i - begin], x);
    own->found->order[own->count] = i;
    own->front->left[i] = 0.0;
    own->count += 1;
}

/* Keeps row i of an equation, of which no pivot is more than nothing, so that it depends on others: its multiplier is
 * zero, or NaN where the border or a right-hand side is more than that. Returns 0, or NaN where a number of the row is
 * not finite. */
static double keep_nothing(search *own, retrax_index i) {
    const retrax_index width = own->front->width, rows = own->front->rows;
    const double *const row = row_of(own->front, i);
    double *const divided = own->found->divided + own->count * width, size = 0.0;
    for (retrax_index j = own->begin; j < rows; j++) {
        size += 0.0 * row[j];
    }
    const bool depends = border_size(own, i) <= NOTHING && size == 0.0;
    memset(own->front->kept + own->count * width, 0, sizeof(double) * (size_t)width);
    memset(divided, 0, sizeof(double) * (size_t)width);
    for (retrax_index j = rows; j < rows + own->front->columns; j++) {
        divided[j] = depends && fabs(row[j]) <= CONSISTENT ? 0.0 : NAN;
    }
    own->found->order[own->count] = i;
    own->front->left[i] = 0.0;
    own->count += 1;
    return size;
}

/* Keeps rows i and r as they are and divided by their pivot of size two, whose inverse is formed relative to the entry
 * beside the diagonal, the largest. */
static void keep_two(search *own, retrax_index i, retrax_index r) {
    const retrax_index width = own->front->width, begin = own->begin, columns = width - begin;
    const double *const x = row_of(own->front, i) + begin, *const y = row_of(own->front, r) + begin;
    double *const kept = own->front->kept + own->count * width, *const divided = own->found->divided + own->count * width;
    const double inverse = 1.0 / x[r - begin], a = x[i - begin] * inverse, c = y[r - begin] * inverse;
    const double both = inverse / (a * c - 1.0);
    memcpy(kept + begin, x, sizeof(double) * (size_t)columns);
    memcpy(kept + width + begin, y, sizeof(double) * (size_t)columns);
    own->kernels->combine(columns, divided + begin, both * c, x, -both, y);
    own->kernels->combine(columns, divided + width + begin, both * a, y, -both, x);
    divided[r] = 0.0;
    divided[width + i] = 0.0;
    own->found->order[own->count] = i;
    own->found->order[own->count + 1] = r;
    own->front->left[i] = 0.0;
    own->front->left[r] = 0.0;
    own->count += 2;
}

/* Size of the smaller eigenvalue of [a b; b c], without cancellation. */
static double smaller_eigenvalue(double a, double b, double c) {
    const double larger = (fabs(a + c) + sqrt((a - c) * (a - c) + 4.0 * b * b)) / 2.0;
    return fabs(a * (c / larger) - b * (b / larger));
}

/* Lists the rows that are left behind the pivots, and subtracts all pivots from them. */
static void finish_left(search *own) {
    retrax_index place = own->count;
    for (retrax_index i = 0; i < own->pivots; i++) {
        if (own->front->left[i] != 0.0) {
            update_row(own, i);
            own->found->order[place++] = i;
        }
    }
    own->found->count = own->count;
}

/* The largest right-hand side of row i. */
static double side_size(const search *own, retrax_index i) {
    double largest = 0.0;
    for (retrax_index j = own->front->rows; j < own->front->rows + own->front->columns; j++) {
        largest = fmax(largest, fabs(row_of(own->front, i)[j]));
    }
    return largest;
}

/* Whether a pivot says that its equation depends on others: there is none, or no more than rounding where the right-hand
 * sides are consistent. */
static bool is_nothing(const search *own, const pivot *chosen) {
    return chosen->i >= own->front->unknowns &&
           (chosen->size == 0.0 || (chosen->size <= NOTHING && side_size(own, chosen->i) <= CONSISTENT));
}

/* Chooses a pivot, beginning with row i; returns by how much it exceeds what keeps its rows stable: 1 or more, or they
 * are not. */
static double stability_of(const search *own, retrax_index i, pivot *to) {
    to->i = i;
    choose_pivot(own, &to->i, &to->r);
    const double *const row = row_of(own->front, to->i), *const other = row_of(own->front, to->r);
    to->size = to->i == to->r ? fabs(row[to->i]) : smaller_eigenvalue(row[to->i], row[to->r], other[to->r]);
    const double border = fmax(border_size(own, to->i), border_size(own, to->r));
    if (is_nothing(own, to)) {
        return border <= NOTHING ? 1.0 : 0.0;
    }
    return border > 0.0 ? to->size / (STABLE * border) : (to->size > 0.0 ? 1.0 : 0.0);
}

/* Finds the next pivot: the first that is stable, from row `first` on; else the most stable one, unless all rows may be
 * left. Returns whether there is one. */
static bool find_pivot(const search *own, retrax_index first, retrax_index most_left, pivot *to) {
    retrax_front *const front = own->front;
    double most = stability_of(own, first, to);
    if (most >= 1.0) {
        return true;
    }
    memset(front->unstable, 0, sizeof(bool) * (size_t)own->pivots);
    front->unstable[first] = front->unstable[to->i] = front->unstable[to->r] = true;
    for (retrax_index i = own->first; i < own->pivots; i++) {
        pivot other;
        if (front->left[i] == 0.0 || front->unstable[i]) {
            continue;
        }
        const double stability = stability_of(own, i, &other);
        front->unstable[i] = front->unstable[other.i] = front->unstable[other.r] = true;
        if (stability > most) {
            most = stability;
            *to = other;
        }
        if (most >= 1.0) {
            return true;
        }
    }
    return own->pivots - own->count > most_left;
}

/* Keeps a pivot, and adds it to the inertia. */
static void keep(search *own, const pivot *chosen, retrax_inertia *inertia) {
    double size = chosen->size;
    /* A pivot of size two has an eigenvalue of either sign. */
    inertia->negative += chosen->i != chosen->r || row_of(own->front, chosen->i)[chosen->i] < 0.0;
    if (is_nothing(own, chosen)) {
        size += keep_nothing(own, chosen->i);
    } else if (chosen->i == chosen->r) {
        keep_one(own, chosen->i);
    } else {
        keep_two(own, chosen->i, chosen->r);
    }
    if (size < inertia->smallest || size != size) {
        inertia->smallest = size;
    }
}

retrax_inertia retrax_front_factorise(const retrax_kernels *kernels, retrax_front *front, retrax_index pivots,
                                      retrax_index most_left, const retrax_index *guess, retrax_index guesses,
                                      retrax_pivots *found) {
    search own = {kernels, front, found, pivots, 0, 0, 0};
    retrax_inertia inertia = {0, INFINITY};
    pivot next;
    for (retrax_index j = 0; j < front->width; j++) {
        front->left[j] = j < pivots ? 1.0 : 0.0;
    }
    memset(front->known, 0, sizeof *front->known * (size_t)front->rows);
    while (own.count < pivots) {
        while (front->left[own.first] == 0.0) {
            own.first++;
        }
        own.begin = own.first & -(retrax_index)RETRAX_VECTOR;
        const bool guessed = own.count < guesses && front->left[guess[own.count]] != 0.0;
        if (!find_pivot(&own, guessed ? guess[own.count] : own.first, most_left, &next)) {
            break;
        }
        keep(&own, &next, &inertia);
    }
    finish_left(&own);
    const retrax_index begin = pivots & -(retrax_index)RETRAX_VECTOR;
    kernels->subtract_products(front->rows - pivots, front->width - begin, own.count,
                               front->matrix + pivots * front->width + begin, front->width, found->divided + pivots,
                               front->width, front->kept + begin, front->width);
    return inertia;
}

void retrax_front_substitute(const retrax_front *front, retrax_index pivots, const retrax_pivots *found,
                             retrax_index column, double *x, double *work) {
    const retrax_index width = front->width;
    for (retrax_index t = 0; t < found->count; t++) {
        const double *const row = found->divided + t * width;
        double value = row[front->rows + column];
        for (retrax_index a = pivots; a < front->rows; a++) {
            value -= row[a] * x[a];
        }
        for (retrax_index l = found->count; l < pivots; l++) {
            value -= row[found->order[l]] * x[found->order[l]];
        }
        work[t] = value;
    }
    for (retrax_index t = found->count - 1; t >= 0; t--) {
        const retrax_index i = found->order[t];
        x[i] = work[t];
        for (retrax_index s = 0; s < t; s++) {
            work[s] -= found->divided[s * width + i] * work[t];
        }
    }
}
