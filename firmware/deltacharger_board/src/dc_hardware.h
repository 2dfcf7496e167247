/* SPDX-License-Identifier: Apache-2.0 */
/* All functions that the board needs from its hardware: implement these and nothing else.
 *
 * No hook may wait: 1 ms is already long; read_taxels may take 2 ms. All are called from dc_board_poll. */
#ifndef DC_HARDWARE_H
#define DC_HARDWARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "dc_float.h"
#include "dc_payload.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The power stage as measured now; NaN where not measured. */
typedef struct {
    float battery;         /* V */
    float target;          /* V at the electrodes, negative = reversed */
    float output;          /* V between the stage and the contactor, which pre-charge brings to `target` */
    float current;         /* A, positive into the target */
    bool contactor_closed; /* the contactor's own feedback, not the command */
    uint8_t fault;         /* reported by the stage's own detectors now, 0 = none: 1 to 7 or 9 of docs/board-link.md */
} dc_power_reading;

/* Outputs to the power stage. All off is safe; the pins must be off while the processor is in reset. */
typedef struct {
    bool precharge;      /* bring the stage's output to the target's voltage, without current */
    bool contactor;      /* energise the contactor's coil */
    float current_limit; /* A, largest current of the stage */
    float voltage;       /* V, constant voltage of a stage whose voltage the board sets, else 0 */
} dc_power_outputs;

typedef struct {
    void *context; /* passed to every hook */

    /* Microseconds, wrapping at 2^32; any start value. */
    uint32_t (*now_us)(void *context);

    /* Take at most `size` bytes received from the host; return their number. */
    size_t (*read)(void *context, uint8_t *bytes, size_t size);

    /* Send at most `size` bytes; return the number accepted. */
    size_t (*write)(void *context, const uint8_t *bytes, size_t size);

    /* Sample both pads: N, raw, left (at +x of the end effector) then right, row-major from the row at +y, column 0 at
     * +x; NaN = dead. */
    void (*read_taxels)(void *context, float forces[DC_TAXELS]);

    void (*read_power)(void *context, dc_power_reading *reading);

    /* Called at every change, and at boot with everything off. */
    void (*set_outputs)(void *context, const dc_power_outputs *outputs);

    /* Start a probe: look at the electrodes without driving them, about 20 ms; only if they have less than 1 V either way,
     * drive them with at most 5 V and 50 mA. The contactor is open. */
    void (*start_probe)(void *context);

    /* True once the result is available, at most 200 ms after start_probe. A port with a voltage of its own: NaN ohm and V
     * (negative = reversed). Else ohm at the end of the driven look (inf = open circuit) and V that the port keeps then.
     * NaN and NaN: not measured. */
    bool (*poll_probe)(void *context, float *resistance, float *target);

    /* Disconnect the probe's voltage from the electrodes, whether it has ended or not. */
    void (*stop_probe)(void *context);

    /* One byte that outlives a reset and a lost supply: the board keeps there whether the contactor has welded. `load` is
     * called at boot, `save` when a weld is found and when a person clears it. A byte that was never saved is not 7. */
    uint8_t (*load)(void *context);
    void (*save)(void *context, uint8_t value);

    /* The servos' bus, if it is connected to the board; else NULL. */

    /* Take at most `size` bytes received from the servos; return their number. */
    size_t (*servo_read)(void *context, uint8_t *bytes, size_t size);

    /* Send at most `size` bytes to the servos; return the number sent. On a half-duplex line it waits until they are
     * out and switches to reception before it returns. It must send no more than fits into half a millisecond,
     * because the link is not read meanwhile. */
    size_t (*servo_write)(void *context, const uint8_t *bytes, size_t size);

    /* Set the speed of the servos' bus, bit/s, and discard received bytes; false, without a change, if the board does
     * not support it. Called at boot too. */
    bool (*servo_speed)(void *context, uint32_t speed);
} dc_hardware;

/* Settings of an installation. */
typedef struct {
    float current_limit;   /* A at most; the electrodes carry 18 */
    float lowest_target;   /* V, lowest voltage that the stage charges */
    float highest_target;  /* V */
    float lowest_battery;  /* V, the charger's own battery under load */
    float highest_battery; /* V */
    /* Longest time between two polls, read_taxels included, us; limited to 20 000. Every deadline of the contactor is
     * shortened by it, so that the contract's limits hold at the pins; the heartbeat's by 10 ms at most. */
    uint32_t poll_period;
    bool steps_up;       /* the stage charges above its battery's voltage */
    float stage_voltage; /* V, constant voltage to which the stage is trimmed; NaN = the board sets it */
    float input_fuse;    /* A, between the battery and the stage */
} dc_config;

static inline uint32_t dc_poll_period(const dc_config *config)
{
    return config->poll_period < 20000u ? config->poll_period : 20000u;
}

#define DC_DEFAULT_CONFIG {18.0f, 10.0f, 30.0f, 22.7f, 29.8f, 0u, true, DC_NAN, 20.0f}

#ifdef __cplusplus
}
#endif

#endif
