/* SPDX-License-Identifier: Apache-2.0 */
/* A bench instead of the hardware: two pads with settable forces and a stage that charges a live battery through a
 * resistor, on a settable clock. Every reading of the power stage can be replaced. */
#ifndef BENCH_H
#define BENCH_H

#include "dc_board.h"

#define BENCH_INPUT 65536u
#define BENCH_OUTPUT (1u << 22)
#define BENCH_BUS 4096u
#define BENCH_READINGS 5u

struct bench {
    uint64_t now;           /* us; the low 32 bits are the board's counter */
    float load[DC_TAXELS];  /* N of contact; NaN = dead */
    bool dead[DC_TAXELS];
    float offset, noise;    /* N on every taxel: mean and standard deviation */
    uint64_t random;
    float battery, target;  /* V; a negative target is reversed */
    float resistance;       /* ohm of the loop, inf = not touching */
    uint8_t detected;       /* fault reported by the stage's own detectors, 0 = none */
    bool welded, stuck;     /* contacts that do not open; that do not close */
    bool dropped;           /* the coil has lost its supply */
    bool is_forced[BENCH_READINGS]; /* whether current, target, output, battery and feedback are replaced by `forced` */
    float forced[BENCH_READINGS];   /* A, V, V, V, 1 = closed */
    bool answers;           /* the probe's answer is replaced by the two below */
    float ohm, volt;
    uint8_t stored;         /* the byte that outlives a boot */
    uint64_t switched_off;  /* us, when the contactor's coil last was */
    uint32_t scan_time;     /* us, duration of read_taxels */
    uint32_t probe_time;    /* us, duration of a probe; UINT32_MAX = never ends */
    bool probing;
    uint64_t probe_due;
    const dc_config *config; /* of the board, which declares the stage */
    dc_power_outputs outputs;
    uint64_t precharged, pulled_in, released; /* us, when output and contacts reach their state */
    uint32_t release_time;  /* us, opening time of the contacts */
    bool closed;
    float broken;           /* A, the largest current interrupted by an opening */
    uint32_t baud;          /* bit/s of the wire, 0 = accepts everything; 1 = accepts nothing */
    uint64_t wire_free;     /* us, the wire is busy until then */
    size_t input_used, input_read, output_used;
    uint32_t servo_speed;   /* bit/s of the servos' bus */
    uint32_t bus_takes;     /* bytes that the bus accepts at once */
    size_t from_servos_used, to_servos_used;
    uint8_t from_servos[BENCH_BUS], to_servos[BENCH_BUS];
    uint8_t input[BENCH_INPUT];
    uint8_t output[BENCH_OUTPUT];
};

void bench_init(struct bench *bench, uint64_t now, uint64_t seed);

/* The hooks of `bench`, including those of a servos' bus if it has one. */
dc_hardware bench_hardware(struct bench *bench, bool servos);

/* Present current, A. */
float bench_current(const struct bench *bench);

/* Return whether both sides of the contactor are connected. */
bool bench_closed(struct bench *bench);

/* Return the next random number. */
uint32_t bench_random(struct bench *bench);

#endif
