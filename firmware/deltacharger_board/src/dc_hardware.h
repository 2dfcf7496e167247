/* SPDX-License-Identifier: Apache-2.0 */
/* Everything the board needs from its hardware: fill this in and nothing else.
 *
 * No hook may wait: a millisecond is long, read_taxels may take two. All run where dc_board_poll is called. */
#ifndef DC_HARDWARE_H
#define DC_HARDWARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "dc_payload.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The power stage as measured now; NaN where not measured. */
typedef struct {
    float battery;         /* V */
    float target;          /* V at the electrodes, negative = reversed, NaN = nothing connected */
    float output;          /* V between the stage and the contactor, which pre-charge brings to `target` */
    float current;         /* A, positive into the target */
    bool contactor_closed; /* the contactor's own feedback, not the command */
    uint8_t fault;         /* what the stage's own detectors report now, 0 none: 1 to 7 or 9 of docs/board-link.md */
} dc_power_reading;

/* What drives the power stage. All off is safe, and what the pins must give while the processor is in reset. */
typedef struct {
    bool precharge;      /* bring the stage's output to the target's voltage, without current */
    bool contactor;      /* energise the contactor's coil */
    float current_limit; /* A that the stage may drive */
} dc_power_outputs;

typedef struct {
    void *context; /* handed to every hook */

    /* Microseconds, wrapping at 2^32; started anywhere. */
    uint32_t (*now_us)(void *context);

    /* Take at most `size` bytes that have come from the host and return how many. */
    size_t (*read)(void *context, uint8_t *bytes, size_t size);

    /* Send at most `size` bytes and return how many were taken. */
    size_t (*write)(void *context, const uint8_t *bytes, size_t size);

    /* Sample both pads: N, raw, left (at +x of the end effector) then right, row-major from the row at +y, column 0 at
     * +x; NaN = dead. */
    void (*read_taxels)(void *context, float forces[DC_TAXELS]);

    void (*read_power)(void *context, dc_power_reading *reading);

    /* Called on every change, and at boot with everything off. */
    void (*set_outputs)(void *context, const dc_power_outputs *outputs);

    /* Begin to measure between the electrodes at no more than 5 V and 50 mA; the contactor is open. */
    void (*start_probe)(void *context);

    /* True once it has been measured: ohm (inf = open circuit) and V of the target (negative = reversed). At most
     * 200 ms after start_probe. */
    bool (*poll_probe)(void *context, float *resistance, float *target);

    /* Take the probe's voltage off the electrodes, whether it has ended or not. */
    void (*stop_probe)(void *context);

    /* The servos' bus, where it hangs on the board; else these are NULL. */

    /* Take at most `size` bytes that have come from the servos and return how many. */
    size_t (*servo_read)(void *context, uint8_t *bytes, size_t size);

    /* Send at most `size` bytes to the servos and return how many were sent. On one line for both directions it waits
     * until they are out and listens before it returns, so it sends no more than half a millisecond holds: meanwhile
     * nobody reads the link. */
    size_t (*servo_write)(void *context, const uint8_t *bytes, size_t size);

    /* Speak to the servos at a speed, bit/s, and forget what came before; false, and nothing changes, where the board
     * does not have it. Called at boot, too. */
    bool (*servo_speed)(void *context, uint32_t speed);
} dc_hardware;

/* What differs between installations. */
typedef struct {
    uint8_t sample_format; /* DC_U8, DC_U12 or DC_U16 */
    float current_limit;   /* A at most; the electrodes carry 18 */
    float lowest_target;   /* V that the stage charges */
    float highest_target;  /* V */
    /* Longest time between two polls, read_taxels included, us; above 20 000 counts as that. Every deadline of the
     * contactor comes that much earlier, so that the contract's limits hold at the pins. */
    uint32_t poll_period;
} dc_config;

static inline uint32_t dc_poll_period(const dc_config *config)
{
    return config->poll_period < 20000u ? config->poll_period : 20000u;
}

#define DC_DEFAULT_CONFIG {DC_U12, 18.0f, 10.0f, 30.0f, 0u}

#ifdef __cplusplus
}
#endif

#endif
