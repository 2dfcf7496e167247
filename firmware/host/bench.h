/* SPDX-License-Identifier: Apache-2.0 */
/* A bench instead of the hardware: two pads under settable forces and a battery that charges a target through a
 * resistor, on a clock that somebody sets. */
#ifndef BENCH_H
#define BENCH_H

#include "dc_board.h"

#define BENCH_INPUT 65536u
#define BENCH_OUTPUT (1u << 22)
#define BENCH_BUS 4096u

struct bench {
    uint64_t now;           /* us; the low 32 bits are the board's counter */
    float load[DC_TAXELS];  /* N of contact; NaN = dead */
    bool dead[DC_TAXELS];
    float offset, noise;    /* N on every taxel: mean and standard deviation */
    uint64_t random;
    float battery, target;  /* V; a negative target is reversed */
    float resistance;       /* ohm of the loop, inf = not touching */
    uint8_t detected;       /* fault that the stage's own detectors report, 0 none */
    bool welded, stuck;     /* contacts that will not open; that will not close */
    bool dropped;           /* the coil has lost its supply */
    bool forced_current, forced_target, forced_output; /* these measure `forced` instead */
    float forced[3];        /* A, V, V */
    uint32_t scan_time;     /* us that read_taxels takes */
    uint32_t probe_time;    /* us that a probe takes; UINT32_MAX = never ends */
    bool probing;
    uint64_t probe_due;
    dc_power_outputs outputs;
    uint64_t precharged, pulled_in, released; /* us, when output and contacts will be there */
    uint32_t release_time;  /* us that the contacts take to open */
    bool closed;
    float broken;           /* A, the largest current that an opening has interrupted */
    uint32_t baud;          /* bits/s of the wire, 0 = takes everything; 1 = takes nothing */
    uint64_t wire_free;     /* us, until when the wire is busy */
    size_t input_used, input_read, output_used;
    uint32_t servo_speed;   /* bit/s of the servos' bus */
    uint32_t bus_takes;     /* bytes that the bus takes at once */
    size_t from_servos_used, to_servos_used;
    uint8_t from_servos[BENCH_BUS], to_servos[BENCH_BUS];
    uint8_t input[BENCH_INPUT];
    uint8_t output[BENCH_OUTPUT];
};

void bench_init(struct bench *bench, uint64_t now, uint64_t seed);

/* The hooks of `bench`, those of a servos' bus among them where it has one. */
dc_hardware bench_hardware(struct bench *bench, bool servos);

/* A at present. */
float bench_current(const struct bench *bench);

/* Whether both sides of the contactor are joined. */
bool bench_closed(struct bench *bench);

/* The next number of a sequence that its seed determines. */
uint32_t bench_random(struct bench *bench);

#endif
