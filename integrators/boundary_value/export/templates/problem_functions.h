/*
 * The functions of @name@, with derivatives, as @name@.c calls them. retrax_core.h says what each reads and writes.
 */
#ifndef @NAME@_FUNCTIONS_H
#define @NAME@_FUNCTIONS_H

/* A function of one point; `evaluate` is NULL where the problem does not have it. */
typedef struct {
    void (*evaluate)(const double *restrict in, double *restrict out);
    int inputs, outputs;
} @name@_function;

/* In the order of retrax_function_name. */
extern const @name@_function @name@_functions[@function_count@];

/* The largest numbers of inputs and outputs. */
enum { @NAME@_MOST_INPUTS = @most_inputs@, @NAME@_MOST_OUTPUTS = @most_outputs@ };

#endif /* @NAME@_FUNCTIONS_H */
