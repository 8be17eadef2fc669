/*
 * Search: Newton's method on the conditions of trajectories, as the files that are parts of it see it.
 */
#ifndef RETRAX_SEARCH_H
#define RETRAX_SEARCH_H

#include "layout.h"
#include "multiphase.h"

/* The largest regularisation of a Hessian: with a larger one a step says nothing. */
#define RETRAX_LARGEST_REGULARISATION 1e10
/* The first one that is tried, relative to the scaled Hessian, and the factor from one to the next. */
#define RETRAX_FIRST_REGULARISATION 1e-4
#define RETRAX_REGULARISATION_FACTOR 10.0

/* A Newton step, and what its elimination tells of the linear system. */
typedef struct {
    double regularisation; /* of the Hessian, which makes the step descend */
    double curvature;   /* along the step, in units of the cost */
    double size;        /* of the step in the same units */
    bool finite;        /* whether there is a step */
    bool strict;        /* whether the Hessian is positive definite on the null space of the constraints, beyond rounding */
    bool inertia_correct; /* whether the inertia is that of such a one, or without inequalities is hidden by rounding */
    bool descends;      /* whether the step has positive curvature */
    double step_cap;    /* the largest part of the step along which no point of constant norm moves by more than its diameter */
    double alpha_max;   /* the largest part of the step that a trial point may make: within the step cap and the fraction to
                         * the boundary */
    double predicted_change;  /* of the cost with its barrier to first order, along alpha_max of the step, in its unit */
    double constraint_change; /* of the constraint term, multipliers times defects, by the step of the multipliers alone */
} retrax_direction;

/* The measures of globalisation, by which trial points are compared. */
typedef struct {
    double infeasibility;   /* INFEASIBILITY: sum of the scaled defects and violations */
    double objective;       /* BARRIER_OBJECTIVE: cost with its barrier, in its unit */
    double constraint_term; /* CONSTRAINT_TERM: the multipliers times the defects, in the same unit */
} retrax_measures;

/* The decision on a trial point, and the globalisation state after it. */
typedef struct {
    bool accepted;
    bool recompute_step;    /* whether a new linear system is solved next; else the step is halved */
    double regularisation;  /* of that system, to begin with */
    double backtrack;       /* of the next trial point */
    double funnel;
    double best;
    retrax_measures measures;
} retrax_judgement;

/* What a search knows of one of its trajectories; arrays stand in the memory of the search. */
typedef struct {
    const retrax_layout *layout;
    retrax_index place;          /* of its numbers in those of an iterate */
    retrax_index guess_place;    /* of its given arrays and unknowns in search->first */
    retrax_scale judging, steps; /* scaling factors that success is judged by, and those of steps */
    retrax_scale fresh;          /* those of the iterate, where they are measured again */
    retrax_limit_scale limits;
    double *constraint_scales;         /* [c] */
    double *curvatures;          /* [z] typical ones, by which Hessians are regularised */
    double *largest;             /* [z] the largest step of each unknown */
    double *sizes, *values;      /* [z] for the scaling factors */
    double *room;                /* [s m] */
    double *work;                /* [2 E] */
    double *ways;                /* [2][N s m] of the controls to the inequalities on either side */
    double *control_work;        /* [N s + 1][m] */
    double *limit_curvatures;    /* [c - bounds][N s][m] of the Lagrangian by the controls, per unit of a multiplier */
    double *square;              /* [z][z] */
    bool *constant_norm;         /* [E + U] of the entries: whether their column has the same norm along the trajectory */
    double step_cap;             /* that of this trajectory, of which the direction has the smallest */
    double dual;                 /* the fraction of the steps of the multipliers of its inequalities that stays inside */
    bool knows;                  /* whether the guess knows multipliers of its inequalities */
    retrax_response response;    /* where ends are coupled */
} retrax_phase;

/* A search; arrays stand in its memory. An iterate is the numbers of all trajectories, then those of the coupling. */
struct retrax_search {
    const retrax_multiphase *problem;
    retrax_phase *phases;        /* [problem->phases] */
    retrax_coupling coupling;    /* of the ends, where they are coupled */
    retrax_options options;
    retrax_instruction_set set;
    bool has_inequalities;       /* whether there are inequalities */
    retrax_index numbers;        /* of an iterate */
    retrax_index residuals;      /* place in an iterate of RESIDUALS of all trajectories together */
    retrax_index totals;         /* and of TOTALS */
    double *at, *trial;          /* the iterate and the trial, which change places */
    double *first;               /* the guess: what is given of each trajectory and its unknowns, then MULTIPLIERS */
    retrax_index guess_multipliers; /* place of these */
    void *workspace;
    double *costs;               /* [max_iterations + 3] of the iterates after 1, 2, ... trials */
    double first_cost;           /* scaling factor of the cost at the guess */
    retrax_direction direction;
    retrax_measures measures;
    double backtrack;  /* part of alpha_max that the trial point makes: 1, and half of it after a rejected trial point */
    double funnel;     /* the infeasibility that no iterate exceeds any more */
    double best;       /* residual so far */
    double correction; /* largest scaled entry of the next Newton step where the error met the tolerance last */
    double penalty_scale; /* times the usual first penalty; its root times the usual first barrier */
    bool isolated;     /* whether Newton's next step is small where the residuals meet the tolerance */
    bool converged;    /* whether the iterate counts as an extremal */
    bool strict;       /* whether the extremal that was found is a strict minimum of the discrete problem */
    bool legendre_holds; /* whether the cost is strictly convex in the controls there, at each point by itself */
    bool inertia_correct; /* whether the limit ended the search where the inertia is that of a minimum */
    bool done;
    bool accepted;     /* whether the last trial was */
    bool stopped;      /* whether the report has asked to stop, be it in the last iteration */
    bool degenerate;   /* whether the guess is one from which Newton's method cannot set out */
    retrax_index trials;
};

/* One of the residuals of an iterate: of all its trajectories together. */
#define RESIDUAL(iterate, name) ((iterate)[search->residuals + RETRAX_##name])

/* Goes through the trajectories of a search. */
#define EACH_PHASE(phase) \
    for (retrax_phase *phase = search->phases, *end_ = phase + search->problem->phases; phase < end_; phase++)

/* Whether the ends of the trajectories are coupled. */
static inline bool retrax_is_coupled(const retrax_search *search) { return search->problem->function.evaluate != NULL; }

/* rotation_cap.c: returns the fraction of the step in which points that keep their size move by no more than a diameter.
 * largest: [z] steps of the unknowns; trial: a trajectory that is overwritten; steady: [E + U] workspace. */
double retrax_step_cap(const retrax_layout *layout, double *trajectory, const double *largest, double *trial,
                       bool *constant_norm);

/* inertia.c: computes the Newton step at the iterate with a regularisation of the Hessian. */
void retrax_newton_step(retrax_search *search, double regularisation);

/* inertia.c: solves the linear system of the iterate with a regularisation of the Hessian, of which that is a part. */
void retrax_eliminate(retrax_search *search, double regularisation);

/* inertia.c: the linear system of a trajectory of the iterate with a regularisation of the Hessian. */
retrax_block_system retrax_newton_system(const retrax_search *search, const retrax_phase *phase, double regularisation);

/* inertia.c: computes the step with the smallest tried regularisation, from `regularisation` on, that makes it descend.
 * accept_any_inertia: the regularisation is used as it is; curvature_test_only: positive curvature along the step is
 * enough. */
void retrax_regularised_step(retrax_search *search, double regularisation, bool accept_any_inertia, bool curvature_test_only);

/* inertia.c: whether the smallest pivot of a system with so many equations of nodes is more than rounding. */
bool retrax_is_clear(double smallest, retrax_index equations);

/* inertia.c: the largest entry of the step in units of the scaling. */
double retrax_step_length(const retrax_search *search);

/* funnel.c: judges the trial point, which was measured; first: no trial point was judged before. */
retrax_judgement retrax_judge_trial(const retrax_search *search, bool first);

/* funnel.c: the measures of globalisation of an iterate that was measured. */
retrax_measures retrax_measures_of(const retrax_search *search, const double *iterate);

/* A piece of the states: an array, but for entries that have a coordinate of their own, which are pieces. */
typedef struct {
    double far;         /* the most that an entry of it is moved by the step, to first order */
    double spread;      /* the most that an entry of it changes along the trajectory */
    retrax_index first; /* its first entry */
} retrax_piece;

/* degenerate.c: finds out which entries of the iterate of one trajectory, which was surveyed, are pieces by
 * themselves. */
void retrax_find_pieces(retrax_search *search);

/* degenerate.c: the piece that an entry belongs to, after retrax_find_pieces. */
retrax_piece retrax_piece_of(const retrax_search *search, retrax_index e);

/* degenerate.c: whether Newton's method cannot set out from the guess. */
bool retrax_is_degenerate(retrax_search *search);

/* rescaling.c: widens sizes of coordinates in which a refused trial lacks more, to second order, than where all moves
 * by its size, as of a rate that only products of others change. part: of the step that was made; length: of the step. */
bool retrax_widen_scale(retrax_search *search, double part, double length);

/* rescaling.c: takes the scaling factors of the iterate where those in use are far larger; returns whether it does. */
bool retrax_renew_scale(retrax_search *search);

/* rescaling.c: whether the cost has fallen by far, and in the second half of the trials by no less than in the first:
 * one with a lower bound falls by less and less on the way to it. */
bool retrax_cost_diverges(const retrax_search *search);

/* conclusion.c: whether the iterate is an extremal: one that counts, meets the tolerance and has ends that meet. */
bool retrax_is_extremal(const retrax_search *search);

/* conclusion.c: finds out whether the conditions of second order hold at the extremal, if it is one. */
void retrax_conclude(retrax_search *search);

/* residuals.c: raises the stationarity of an iterate, of which each trajectory was measured, to that relative to what
 * its unknowns span: scaling factors are what controls reach, and an unstable system reaches farther than any
 * solution. */
void retrax_measure_by_spans(const retrax_search *search, double *iterate);

/* residuals.c: what an unknown of the steps spans along the trajectory: its spread, or a share of its value; the size
 * of a control. */
double retrax_span_of(const retrax_layout *layout, const double *trajectory, retrax_index i);

/* residuals.c: whether an entry has a coordinate of its own, which moves nothing else. */
bool retrax_is_alone(const double *support, retrax_index n, retrax_index E, retrax_index entry);

/* warm_start.c: sets first slacks and multipliers near to the multipliers that the guess, search->first, knows, of which
 * the evaluated iterate has the unknowns. Returns whether they fit. */
bool retrax_warm_start(retrax_search *search);

/* barrier.c: whether no iterate leaves an inequality, as a bound of what is free. */
bool retrax_is_never_elastic(const retrax_phase *phase, retrax_index i);

/* barrier.c: the value of an inequality; a bound that no iterate leaves holds by rounding at least. */
double retrax_limit_inside(const retrax_phase *phase, const double *trajectory, retrax_index i);

/* barrier.c: sets slacks and multipliers of inequalities that do not pull. */
void retrax_rest_slacks(const retrax_layout *layout, double *trajectory);

/* barrier.c: finds the scaling factors of the inequalities of an evaluated trajectory. */
void retrax_find_limits(retrax_phase *phase, const double *trajectory);

/* barrier.c: the scaling factors of the inequalities, and the first slacks of an evaluated trajectory. */
void retrax_start_slacks(const retrax_search *search, retrax_phase *phase, double *trajectory);

/* barrier.c: lowers the barrier while its problem is solved, raises penalties that are too small, and makes
 * inequalities elastic where steps jam. Returns whether the iterate is another one. */
bool retrax_update_barrier(retrax_search *search);

/* barrier.c: sets slacks that a step missed, where their inequalities hold; returns whether there were any. */
bool retrax_reset_slacks(const retrax_search *search, double *iterate);

/* barrier.c: whether inequalities contradict each other, or the ends. */
bool retrax_is_infeasible(const retrax_search *search);

/* barrier.c: whether there are inequalities that are not elastic yet and can be. */
bool retrax_is_not_yet_elastic(const retrax_search *search);

/* initialise.c: scaling factors, first slacks and first multipliers of the guess, and the first step. */
void retrax_initialise(retrax_search *search);

/* initialise.c: the scaling factors of the guess, as where inequalities do not pull yet, and its first slacks. */
void retrax_begin(retrax_search *search);

/* initialise.c: takes what is given and the unknowns of the guess. */
void retrax_return_to_guess(retrax_search *search);

/* initialise.c: takes the multipliers of the equations from an iterate. */
void retrax_forget_multipliers(const retrax_search *search, double *iterate);

/* control_range.c: writes how inequalities curve the Lagrangian in the controls at the iterate, which was evaluated, to
 * phase->limit_curvatures, for retrax_find_scale. The trial is overwritten. */
void retrax_find_limit_curvatures(retrax_search *search);

/* control_range.c: writes half of the way of each control of a step from one inequality to the other, or that to the only
 * one, 0 where there is none, the largest of all steps; and the same in phase->room, but infinite where a side is
 * open. */
void retrax_find_control_ranges(retrax_phase *phase, const double *trajectory, double *ways_found);

/* initialise.c: writes the scaling factors of an evaluated trajectory to phase->fresh; least: [n] what the coordinates of
 * its nodes have to move by at least, or NULL. */
void retrax_find_scale(retrax_search *search, retrax_phase *phase, const double *trajectory, const double *least);

/* initialise.c: the same of all trajectories of an iterate. */
void retrax_find_scales(retrax_search *search, double *iterate);

/* initialise.c: copies the unknowns of a trajectory. */
void retrax_copy_unknowns(const retrax_layout *layout, const double *from, double *to);

/* initialise.c: the same of all trajectories of an iterate, with the multipliers of their coupling. */
void retrax_copy_iterate(const retrax_search *search, const double *from, double *to);

/* initialise.c: the largest size of control i of a step along the trajectory. */
double retrax_control_size(const retrax_layout *layout, const double *trajectory, retrax_index i);

/* algorithm.c: evaluates the functions of the problem at an iterate. */
void retrax_evaluate_functions(const retrax_search *search, double *iterate);

/* algorithm.c: assembles the linear system of an iterate whose functions were evaluated. */
void retrax_assemble(const retrax_search *search, double *iterate);

/* algorithm.c: evaluates an iterate and assembles its linear system. */
void retrax_evaluate(const retrax_search *search, double *iterate);

/* algorithm.c: measures an evaluated iterate. */
void retrax_measure(retrax_search *search, double *iterate);

/* algorithm.c: both of these. */
void retrax_assess(retrax_search *search, double *iterate);

/* algorithm.c: writes the unknowns of the trial after the fraction of the step that is tried. */
void retrax_move_trial(const retrax_search *search);

/* algorithm.c: tells where the search is; returns whether it is asked to stop. */
bool retrax_report(const retrax_search *search);

/* algorithm.c: writes the unknowns of an iterate after a fraction of the step from search->at. */
void retrax_move_iterate(const retrax_search *search, double alpha, double *iterate);

/* multiphase.c: evaluates what couples the ends of an iterate, which have been evaluated, with their costs. */
void retrax_evaluate_coupling(const retrax_search *search, double *iterate);

/* multiphase.c: the largest curvature of the cost of an iterate in units of the scaling, which sets the scale of slopes
 * where their parts vanish. */
double retrax_largest_curvature(const retrax_search *search, const double *iterate);

/* multiphase.c: writes the residuals of all trajectories together, each of which was measured. */
void retrax_join_residuals(const retrax_search *search, double *iterate);

/* multiphase.c: writes the scaling factors of all trajectories of an evaluated iterate, and of the equations between
 * their ends. */
void retrax_find_coupled_scales(retrax_search *search, double *iterate);

/* multiphase.c: writes the multipliers of the coupling after a fraction of the step from search->at. */
void retrax_move_coupling(const retrax_search *search, double part, double *iterate);

/* response.c: finds how a trajectory of the iterate follows its ends with a regularisation of the Hessian; returns the
 * inertia. */
retrax_inertia retrax_respond(const retrax_search *search, retrax_phase *phase, double regularisation);

/* border.c: computes the Newton step of coupled trajectories with a regularisation of the Hessian. */
void retrax_eliminate_coupled(retrax_search *search, double regularisation);

/* border.c: adds what the coupling changes to what a step promises. */
void retrax_add_coupled_change(retrax_search *search);

/* algorithm.c: lets iterate and trial change places. */
void retrax_swap(retrax_search *search);

/* algorithm.c: copies scaling factors. */
void retrax_copy_scale(const retrax_layout *layout, const retrax_scale *from, retrax_scale *to);

#endif /* RETRAX_SEARCH_H */
