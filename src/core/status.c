/* Version and status messages of the core. */
#include "retrax_core.h"

int retrax_core_version(void) { return RETRAX_CORE_VERSION; }

const char *retrax_status_message(int status) {
    switch (status) {
        case RETRAX_OK:
            return "no error";
        case RETRAX_BAD_SIZE:
            return "a count is negative or an array is missing";
        case RETRAX_BAD_INSTRUCTION:
            return "a code is not in the list of instructions";
        case RETRAX_BAD_REGISTER:
            return "an operand is not a register, or a result overwrites an operand";
        case RETRAX_BAD_PLACE:
            return "an input or output lies outside of its array";
        case RETRAX_BAD_LOOP:
            return "a loop has no beginning, no end, or no whole number of rounds";
        case RETRAX_BAD_LANES:
            return "the number of lanes is not a positive multiple of 8";
        default:
            return "unknown status";
    }
}
