/*
 * Runs random tapes, sound and broken ones, in arrays of exactly their size: for the sanitizers and valgrind.
 *
 * usage: fuzz_tape COUNT SEED
 *
 * A tape that the check accepts must run without leaving its arrays, and give the same numbers whatever the lanes.
 */
#include "../../src/core/tape.h"
#include "fuzz.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LONGEST 60
#define MOST_ROUNDS 20

typedef struct {
    retrax_tape tape;
    uint8_t codes[LONGEST];
    uint32_t operands[LONGEST][RETRAX_OPERANDS];
    double values[LONGEST];
} program;

/* A program of known form: inputs, instructions, perhaps a loop, outputs. Every register is written before. */
static void write_program(generator *g, program *p) {
    const retrax_index inputs = 1 + below(g, 9), outputs = 1 + below(g, 9), length = 1 + below(g, 24);
    const retrax_index begin = inputs, end = inputs + length, count = end + outputs;
    memset(p, 0, sizeof *p);
    for (retrax_index k = 0; k < count; k++) {
        uint32_t *const r = p->operands[k];
        p->values[k] = number(g);
        r[0] = (uint32_t)k;
        for (int i = 1; i < RETRAX_OPERANDS; i++) {
            r[i] = (uint32_t)below(g, k == 0 ? 1 : (k < end ? k : end));
        }
        do {
            p->codes[k] = (uint8_t)below(g, RETRAX_CODES);
        } while ((p->codes[k] >= RETRAX_INPUT && p->codes[k] <= RETRAX_REPEAT) || p->codes[k] == RETRAX_COPYSIGN);
        if (k < begin || k >= end) {
            const retrax_index place = k < begin ? k : k - end, numbers = k < begin ? inputs : outputs;
            p->codes[k] = k < begin ? RETRAX_INPUT : RETRAX_OUTPUT;
            p->values[k] = (double)place;
            r[2] = place + RETRAX_GROUP <= numbers && below(g, 2) == 0 ? RETRAX_GROUP : 0;
        }
    }
    if (length > 6 && below(g, 2) == 0) { /* a number that changes, which what is around the loop writes anew */
        const retrax_index first = begin + 1, last = end - 2;
        p->codes[begin] = RETRAX_STATE;
        p->codes[first] = RETRAX_LOOP;
        p->values[first] = (double)(1 + below(g, MOST_ROUNDS));
        p->operands[first][0] = 0;
        p->codes[first + 1] = RETRAX_SQ; /* a register for what the code of the loop would have written */
        p->operands[first + 1][1] = (uint32_t)begin;
        p->codes[last - 1] = RETRAX_NEXT;
        p->operands[last - 1][0] = (uint32_t)begin;
        p->operands[last - 1][1] = (uint32_t)(first + 1);
        p->codes[last] = RETRAX_REPEAT;
        p->values[last] = (double)(first + 1);
        p->operands[last][0] = 0;
        p->operands[last][1] = (uint32_t)(first + 1);
    }
    p->tape.instructions = count;
    p->tape.registers = count;
    p->tape.inputs = inputs;
    p->tape.outputs = outputs;
}

/* Some changes at random places. */
static void damage(generator *g, program *p) {
    for (retrax_index changes = below(g, 4); changes > 0; changes--) {
        const retrax_index k = below(g, p->tape.instructions);
        switch (below(g, 6)) {
            case 0:
                p->codes[k] = (uint8_t)below(g, below(g, 2) == 0 ? 256 : RETRAX_CODES);
                break;
            case 1:
                p->operands[k][below(g, RETRAX_OPERANDS)] = (uint32_t)below(g, 2 * p->tape.registers);
                break;
            case 2:
                p->values[k] = below(g, 2) == 0 ? number(g) : (double)below(g, 2 * LONGEST);
                break;
            case 3:
                p->operands[k][2] = RETRAX_GROUP;
                break;
            case 4:
                p->tape.registers = below(g, 2 * p->tape.registers + 1);
                break;
            default:
                *(below(g, 2) == 0 ? &p->tape.inputs : &p->tape.outputs) = below(g, 10);
                break;
        }
        p->tape.registers += p->tape.registers == 0;
    }
}

/* Places of numbers in rows or in columns, with gaps, or, unless they must be sound, anywhere; returns the size of an
 * array that may have them. */
static retrax_index write_places(generator *g, retrax_index (*places)[2], retrax_index count, retrax_index points,
                                 int sound) {
    const retrax_index gap = below(g, 3), size = (count + gap) * points;
    const retrax_index kind = below(g, sound ? 7 : 8);
    for (retrax_index i = 0; i < count; i++) {
        places[i][0] = kind < 4 ? i : i * points;
        places[i][1] = kind < 4 ? count + gap : 1;
        if (kind == 7) {
            places[i][0] = below(g, size + 2) - 1;
            places[i][1] = below(g, 9) - 4;
        }
    }
    return size;
}

static double *numbers(generator *g, retrax_index count) {
    double *const found = malloc(sizeof(double) * (size_t)(count > 0 ? count : 1));
    for (retrax_index i = 0; i < count; i++) {
        found[i] = number(g);
    }
    return found;
}

static int differ(const double *a, const double *b, retrax_index count) {
    for (retrax_index i = 0; i < count; i++) {
        if (!(a[i] == b[i] || (isnan(a[i]) && isnan(b[i])))) {
            return 1;
        }
    }
    return 0;
}

static int has_loop(const program *p) {
    return memchr(p->codes, RETRAX_LOOP, (size_t)p->tape.instructions) != NULL;
}

static int is_long(const program *p) {
    for (retrax_index k = 0; k < p->tape.instructions; k++) {
        if (p->codes[k] == RETRAX_LOOP && p->values[k] > MOST_ROUNDS) {
            return 1;
        }
    }
    return 0;
}

/* Runs a program with each instruction set and several lanes; returns 1 if it ran, 0 if it was refused, -1 if numbers
 * differ. */
static int run(generator *g, program *p, int sound) {
    /* Copies of exactly the size that the program says. */
    const size_t count = (size_t)p->tape.instructions;
    uint8_t *const codes = malloc(count);
    uint32_t(*const operands)[RETRAX_OPERANDS] = malloc(count * sizeof *operands);
    double *const values = malloc(count * sizeof *values);
    memcpy(codes, p->codes, count);
    memcpy(operands, p->operands, count * sizeof *operands);
    memcpy(values, p->values, count * sizeof *values);
    retrax_tape tape = p->tape;
    tape.codes = codes;
    tape.operands = (const uint32_t(*)[RETRAX_OPERANDS])operands;
    tape.values = values;

    const retrax_index points = 1 + below(g, 40), first = below(g, points);
    retrax_index(*const sources)[2] = malloc(sizeof *sources * (size_t)(tape.inputs + 1));
    retrax_index(*const targets)[2] = malloc(sizeof *targets * (size_t)(tape.outputs + 1));
    retrax_tape_data data = {0};
    data.input_size = write_places(g, sources, tape.inputs, points, sound);
    data.output_size = write_places(g, targets, tape.outputs, points, sound);
    double *const inputs = numbers(g, data.input_size), *const outputs = numbers(g, data.output_size);
    double *const expected = numbers(g, data.output_size);
    data.inputs = inputs;
    data.sources = (const retrax_index(*)[2])sources;
    data.targets = (const retrax_index(*)[2])targets;
    memcpy(expected, outputs, sizeof(double) * (size_t)data.output_size);

    int result = 0;
    if (retrax_tape_check(&tape) == RETRAX_OK && !is_long(p)) {
        const retrax_instruction_set best = retrax_best_instruction_set();
        for (int trial = 0; trial < 6 && result >= 0; trial++) {
            const retrax_index several = below(g, 3) == 0 ? 1 : 8 * (1 + below(g, 5));
            const retrax_index lanes = trial < 2 ? retrax_tape_lanes(&tape, points) : several;
            const retrax_instruction_set set = (retrax_instruction_set)(trial % 3);
            data.outputs = trial == 1 ? expected : outputs;
            if (set > best || retrax_tape_check_data(&tape, &data, first, points, lanes) != RETRAX_OK) {
                continue;
            }
            double *const registers = numbers(g, tape.registers * lanes);
            retrax_tape_run(&tape, &data, first, points, registers, lanes, set);
            free(registers);
            result = 1;
            if (sound && !has_loop(p) && trial > 1 && set == (retrax_instruction_set)1) {
                result = differ(outputs, expected, data.output_size) ? -1 : 1;
            }
        }
    }
    free(codes);
    free(operands);
    free(values);
    free(sources);
    free(targets);
    free(inputs);
    free(outputs);
    free(expected);
    return result;
}

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "usage: fuzz_tape COUNT SEED\n");
        return 2;
    }
    const long count = atol(argv[1]);
    generator g = {0x9E3779B97F4A7C15u ^ (uint64_t)atol(argv[2]), 3};
    long ran[2] = {0, 0};
    for (long k = 0; k < count; k++) {
        program p;
        const int sound = k % 2 == 0;
        write_program(&g, &p);
        if (!sound) {
            damage(&g, &p);
        }
        const int result = run(&g, &p, sound);
        if (result < 0) {
            fprintf(stderr, "program %ld: lanes change the numbers\n", k);
            return 1;
        }
        ran[sound] += result;
    }
    printf("sound programs that ran: %ld, damaged ones: %ld, of %ld\n", ran[1], ran[0], count);
    return 0;
}
