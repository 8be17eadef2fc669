/*
 * The functions of @name@, with derivatives: straight-line code for one point, written by retrax @version@.
 */
#include "@name@_functions.h"

#include <stddef.h>

@functions@

const @name@_function @name@_functions[@function_count@] = {
@table@
};
