/*
 * Constants with one meaning in several files; those of one file stand there.
 */
#ifndef RETRAX_CONSTANTS_H
#define RETRAX_CONSTANTS_H

/* Root of the precision: half of the digits. Relative to what a number is made of, a smaller part is rounding. */
#define RETRAX_ROOT_EPS 1.4901161193847656e-08
/* An entry that moves by a smaller share of its value is constant, but for rounding. */
#define RETRAX_STILL 1e-12
/* Share of its scaling factor by which a coordinate, or a part of a sum, is measured where it is less. */
#define RETRAX_SHARE 1e-3
/* Share of its value by which an entry, or an inequality, is measured where it changes by less: values are rounded. */
#define RETRAX_VALUE_SHARE 1e-2
/* The regularisation of the Hessian with which a step is the least that the constraints ask for, whatever it costs. */
#define RETRAX_LEAST_NORM_REGULARISATION 1e6
/* The shortest fraction of a step, a power of two. */
#define RETRAX_SHORTEST 0.0625
/* The usual first penalty of an excess, in units of the scaling. */
#define RETRAX_FIRST_PENALTY 10.0
/* The last barrier, relative, as a share of the tolerance. */
#define RETRAX_LAST_BARRIER 0.1
/* The usual tolerance in double precision: eps^0.7, as DEFAULT_TOLERANCE_POWER of Python has it. */
#define RETRAX_USUAL_TOLERANCE 1.1028289493045307e-11

#endif /* RETRAX_CONSTANTS_H */
