/* Tapes: checks, lanes, and the machine that runs them, once for each instruction set. */
#include "tape.h"

#include "instruction_sets.h"

#include <math.h>
#include <stdbool.h>

/* Lanes that an instruction acts on where the registers leave the choice: enough to hide the time that it takes to
 * choose an instruction, and registers of all lanes that fit the near caches. */
#define LEAST_LANES 64
#define MOST_LANES 256
#define CACHED_NUMBERS 16384

/* Largest whole number such that all whole numbers below are exact. */
#define LARGEST_WHOLE 9007199254740992.0

/* ------------------------------------------------------------------------------------------------- checks */

const char *retrax_tape_instruction_name(int code) {
#define NAME_OF(name, arguments) #name,
    static const char *const names[] = {RETRAX_INSTRUCTIONS(NAME_OF)};
#undef NAME_OF
    return code >= 0 && code < RETRAX_CODES ? names[code] : NULL;
}

/* Number of arguments of an instruction. */
static int arguments_of(uint8_t code) {
#define ARGUMENTS_OF(name, arguments) arguments,
    static const signed char arguments[] = {RETRAX_INSTRUCTIONS(ARGUMENTS_OF)};
#undef ARGUMENTS_OF
    return arguments[code];
}

/* Whether a value is a whole number with least <= value < end. */
static bool is_whole(double value, retrax_index least, double end) {
    return value >= (double)least && value < end && value == floor(value);
}

/* Whether the arguments of instruction k are registers, its result too if it has one, and the two differ. */
static bool has_registers(const retrax_tape *tape, retrax_index k, int arguments) {
    const uint32_t *const r = tape->operands[k];
    const uint8_t code = tape->codes[k];
    const bool result = code != RETRAX_OUTPUT && code != RETRAX_LOOP && code != RETRAX_REPEAT;
    if (result && (retrax_index)r[0] >= tape->registers) {
        return false;
    }
    for (int i = 1; i <= arguments; i++) {
        if ((retrax_index)r[i] >= tape->registers || (result && r[i] == r[0])) {
            return false;
        }
    }
    return true;
}

/* Whether input or output k has a place; and if it says so, whether the three after it are of the same kind, with
 * the places that follow. */
static bool has_place(const retrax_tape *tape, retrax_index k, retrax_index numbers) {
    const double place = tape->values[k];
    const uint32_t together = tape->operands[k][2];
    if (!is_whole(place, 0, (double)numbers) || (together != 0 && together != RETRAX_GROUP)) {
        return false;
    }
    if (together == 0) {
        return true;
    }
    if (k + RETRAX_GROUP > tape->instructions) {
        return false;
    }
    for (int i = 1; i < RETRAX_GROUP; i++) {
        if (tape->codes[k + i] != tape->codes[k] || tape->values[k + i] != place + i) {
            return false;
        }
    }
    return true;
}

retrax_status retrax_tape_check(const retrax_tape *tape) {
    const retrax_index most = (retrax_index)UINT32_MAX;
    if (tape == NULL || tape->instructions < 0 || tape->registers < 0 || tape->inputs < 0 || tape->outputs < 0 ||
        tape->registers > most) {
        return RETRAX_BAD_SIZE;
    }
    if (tape->instructions > 0 && (tape->codes == NULL || tape->operands == NULL || tape->values == NULL)) {
        return RETRAX_BAD_SIZE;
    }
    retrax_index begin = 0; /* first instruction of the loop that is open, 0 if there is none */
    for (retrax_index k = 0; k < tape->instructions; k++) {
        const uint8_t code = tape->codes[k];
        if (code >= RETRAX_CODES) {
            return RETRAX_BAD_INSTRUCTION;
        }
        if (!has_registers(tape, k, arguments_of(code))) {
            return RETRAX_BAD_REGISTER;
        }
        if ((code == RETRAX_INPUT && !has_place(tape, k, tape->inputs)) ||
            (code == RETRAX_OUTPUT && !has_place(tape, k, tape->outputs))) {
            return RETRAX_BAD_PLACE;
        }
        if (code == RETRAX_LOOP) {
            if (begin > 0 || !is_whole(tape->values[k], 1, LARGEST_WHOLE)) {
                return RETRAX_BAD_LOOP;
            }
            begin = k + 1;
        } else if (code == RETRAX_REPEAT) {
            if (begin == 0 || tape->values[k] != (double)begin) {
                return RETRAX_BAD_LOOP;
            }
            begin = 0;
        }
    }
    return begin > 0 ? RETRAX_BAD_LOOP : RETRAX_OK;
}

/* Whether the numbers of points 0 to `last` - 1, at least one, lie in an array of this size. */
static bool fits(const retrax_index (*places)[2], retrax_index count, retrax_index last, retrax_index size) {
    for (retrax_index i = 0; i < count; i++) {
        const retrax_index place = places[i][0], step = places[i][1];
        if (place < 0 || place >= size) {
            return false;
        }
        if (last == 1 || step == 0) {
            continue;
        }
        /* 0 <= place + (last - 1) step < size, in a form that cannot overflow */
        const retrax_index room = step < 0 ? place : size - 1 - place;
        if (step <= -size || step >= size || room / (step < 0 ? -step : step) < last - 1) {
            return false;
        }
    }
    return true;
}

retrax_status retrax_tape_check_data(const retrax_tape *tape, const retrax_tape_data *data, retrax_index first,
                                     retrax_index last, retrax_index lanes) {
    if (first < 0 || last < first || data->input_size < 0 || data->output_size < 0) {
        return RETRAX_BAD_SIZE;
    }
    if (lanes != 1 && (lanes <= 0 || lanes % RETRAX_VECTOR != 0)) {
        return RETRAX_BAD_LANES;
    }
    if (last == first) {
        return RETRAX_OK;
    }
    if ((tape->inputs > 0 && (data->inputs == NULL || data->sources == NULL)) ||
        (tape->outputs > 0 && (data->outputs == NULL || data->targets == NULL))) {
        return RETRAX_BAD_SIZE;
    }
    const bool fit = fits(data->sources, tape->inputs, last, data->input_size) &&
                     fits(data->targets, tape->outputs, last, data->output_size);
    return fit ? RETRAX_OK : RETRAX_BAD_PLACE;
}

/* ------------------------------------------------------------------------------------------------- lanes */

retrax_index retrax_tape_lanes(const retrax_tape *tape, retrax_index points) {
    retrax_index most = CACHED_NUMBERS / (tape->registers > 0 ? tape->registers : 1);
    most = most < LEAST_LANES ? LEAST_LANES : (most > MOST_LANES ? MOST_LANES : most);
    const retrax_index blocks = points > most ? (points + most - 1) / most : 1;
    const retrax_index vectors = (points + blocks * RETRAX_VECTOR - 1) / (blocks * RETRAX_VECTOR);
    return RETRAX_VECTOR * (vectors > 0 ? vectors : 1);
}

/* --------------------------------------------------------------------------------------- inputs and outputs */

/* Whether the four numbers from place i on are neighbours at every point. */
static bool are_neighbours(const retrax_index (*places)[2], retrax_index i) {
    bool found = true;
    for (int n = 1; n < RETRAX_GROUP; n++) {
        found = found && places[i + n][0] == places[i][0] + n && places[i + n][1] == places[i][1];
    }
    return found;
}

/* Reads input k, or four inputs from k on, at `count` points; returns the number of instructions that this was. */
static retrax_index read_inputs(const retrax_tape *tape, const retrax_tape_data *data, retrax_index k,
                                retrax_index point, retrax_index count, double *registers, retrax_index lanes) {
    const retrax_index i = (retrax_index)tape->values[k], step = data->sources[i][1];
    const double *from = data->inputs + data->sources[i][0] + point * step;
    const uint32_t(*const r)[RETRAX_OPERANDS] = tape->operands + k;
    double *restrict const first = registers + (retrax_index)r[0][0] * lanes;
    if (r[0][2] != RETRAX_GROUP || !are_neighbours(data->sources, i)) {
        for (retrax_index j = 0; j < count; j++) {
            first[j] = from[j * step];
        }
        return 1;
    }
    double *const second = registers + (retrax_index)r[1][0] * lanes;
    double *const third = registers + (retrax_index)r[2][0] * lanes;
    double *const fourth = registers + (retrax_index)r[3][0] * lanes;
    for (retrax_index j = 0; j < count; j++, from += step) {
        first[j] = from[0];
        second[j] = from[1];
        third[j] = from[2];
        fourth[j] = from[3];
    }
    return RETRAX_GROUP;
}

/* Writes output k, or four outputs from k on, at `count` points; returns the number of instructions that this was. */
static retrax_index write_outputs(const retrax_tape *tape, const retrax_tape_data *data, retrax_index k,
                                  retrax_index point, retrax_index count, const double *registers,
                                  retrax_index lanes) {
    const retrax_index i = (retrax_index)tape->values[k], step = data->targets[i][1];
    double *to = data->outputs + data->targets[i][0] + point * step;
    const uint32_t(*const r)[RETRAX_OPERANDS] = tape->operands + k;
    const double *const first = registers + (retrax_index)r[0][1] * lanes;
    if (r[0][2] != RETRAX_GROUP || !are_neighbours(data->targets, i)) {
        for (retrax_index j = 0; j < count; j++) {
            to[j * step] = first[j];
        }
        return 1;
    }
    const double *const second = registers + (retrax_index)r[1][1] * lanes;
    const double *const third = registers + (retrax_index)r[2][1] * lanes;
    const double *const fourth = registers + (retrax_index)r[3][1] * lanes;
    for (retrax_index j = 0; j < count; j++, to += step) {
        to[0] = first[j];
        to[1] = second[j];
        to[2] = third[j];
        to[3] = fourth[j];
    }
    return RETRAX_GROUP;
}

/* Whether any of the numbers is zero. */
static bool any_is_zero(const double *numbers, retrax_index count) {
    bool found = false;
    for (retrax_index j = 0; j < count; j++) {
        found |= numbers[j] == 0.0;
    }
    return found;
}

/* ------------------------------------------------------------------------------------------------- machine */

#define FUSED RETRAX_PORTABLE_FUSED
#define TARGET
#define ALONE false
#define MACHINE run_portable
#include "tape_machine.h"
#undef ALONE
#undef MACHINE

#define ALONE true
#define MACHINE run_one_portable
#include "tape_machine.h"
#undef ALONE
#undef MACHINE
#undef FUSED
#undef TARGET

#if RETRAX_HAS_X86_SETS
#define FUSED __builtin_fma
#define ALONE true
#define MACHINE run_one_fused
#define TARGET RETRAX_TARGET_AVX2
#include "tape_machine.h"
#undef ALONE
#undef MACHINE
#undef TARGET

#define ALONE false
#define MACHINE run_avx2
#define TARGET RETRAX_TARGET_AVX2
#include "tape_machine.h"
#undef MACHINE
#undef TARGET

#define MACHINE run_avx512
#define TARGET RETRAX_TARGET_AVX512
#include "tape_machine.h"
#undef MACHINE
#undef TARGET
#undef ALONE
#undef FUSED
#endif

/* Runs the tape at one point, whose registers are a column. */
static void run_one(const retrax_tape *tape, const retrax_tape_data *data, retrax_index point, double *registers,
                    retrax_instruction_set set) {
#if RETRAX_HAS_X86_SETS
    if (set != RETRAX_PORTABLE) {
        run_one_fused(tape, data, point, 1, registers, 1);
        return;
    }
#endif
    (void)set;
    run_one_portable(tape, data, point, 1, registers, 1);
}

void retrax_tape_run(const retrax_tape *tape, const retrax_tape_data *data, retrax_index first, retrax_index last,
                     double *registers, retrax_index lanes, retrax_instruction_set set) {
    for (retrax_index point = first; point < last; point += lanes) {
        const retrax_index count = last - point < lanes ? last - point : lanes;
        if (lanes == 1) {
            run_one(tape, data, point, registers, set);
            continue;
        }
        switch (set) {
#if RETRAX_HAS_X86_SETS
            case RETRAX_AVX2:
                run_avx2(tape, data, point, count, registers, lanes);
                break;
            case RETRAX_AVX512:
                run_avx512(tape, data, point, count, registers, lanes);
                break;
#endif
            default:
                run_portable(tape, data, point, count, registers, lanes);
                break;
        }
    }
}
