/* SPDX-License-Identifier: Apache-2.0 */
/* The power stage's sequence and its detectors: pre-charge, contactor, ramp up; ramp down, open, confirm.
 *
 * dc_contactor decides when to close and open; this module executes it, without packets, probes and heartbeats. */
#ifndef DC_STAGE_H
#define DC_STAGE_H

#include <stdbool.h>
#include <stdint.h>

#include "dc_hardware.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Times in us, limits in V and A; docs/firmware.md gives the source of each. */
#define DC_PRECHARGE_TIMEOUT_US 500000u
#define DC_PRECHARGE_MATCH 1.0f       /* V between both sides of the contactor when it closes */
#define DC_PULL_IN_TIMEOUT_US 100000u /* until the feedback shows closed */
#define DC_RAMP_UP 40.0f              /* A/s */
#define DC_RAMP_DOWN 500.0f           /* A/s: 18 A in 36 ms */
#define DC_RAMP_DOWN_TIMEOUT_US 50000u
#define DC_OPEN_CURRENT 1.0f          /* A; below it a ramped opening opens the contactor */
#define DC_ZERO_TIMEOUT_US 50000u     /* from the opening until feedback and current must confirm it */
#define DC_ZERO_CURRENT 0.5f          /* A */
#define DC_LARGEST_CURRENT 20.0f      /* A */
#define DC_REVERSE_LIMIT (-0.5f)      /* A, for DC_BLIND_TIMEOUT_US: a robot that brakes */
#define DC_REVERSE_AT_ONCE (-5.0f)    /* A */
#define DC_REVERSED (-1.0f)           /* V, at which a target is swapped; a dead one is 0 V with noise */
#define DC_SHORT_VOLTAGE 2.0f         /* V; no target has less while current flows */
#define DC_IDLE_CURRENT 0.05f         /* A; below it no current flows */
#define DC_LOST_TIMEOUT_US 50000u     /* without current until the limit falls */
#define DC_GAP_CURRENT 1.0f           /* A, limit while no current flows: what returns is ramped up */
#define DC_START_CURRENT 0.5f         /* A, limit until a dead port has started */
#define DC_START_TIME_US 200000u      /* with current and a voltage, without a break, until it has */
#define DC_OVER_VOLTAGE 0.3f          /* V above the closing's voltage */
#define DC_STEP_DOWN 0.5f             /* V that a stage which does not step up needs above the target */
#define DC_FUSE_SHARE 0.9f            /* of the fuse's current, after the stage's losses */
#define DC_BLIND_TIMEOUT_US 100000u   /* without a measured current, or with a voltage unmeasured or out of range */
#define DC_SAG_TIMEOUT_US 5000000u    /* with a low battery, which sags under load */
#define DC_BOUNCE_TIME_US 20000u      /* with open feedback, counted from the first opening */
#define DC_BOUNCE_PERIOD_US 100000u   /* between the first openings of two bounces */

typedef enum { DC_OPEN, DC_PRECHARGE, DC_CLOSING, DC_CLOSED, DC_RAMPING_DOWN } dc_stage_state;

typedef struct {
    const dc_hardware *hardware;
    const dc_config *config;
    dc_limits limits; /* of this closing */
    dc_stage_state state;
    dc_power_outputs outputs;
    uint64_t since;   /* us, when `state` began */
    uint64_t stepped; /* us, the last step */
    uint64_t flowing; /* us, when current last flowed, or first could */
    uint64_t rising;  /* us, since when current flows into a voltage in range */
    uint64_t forward; /* us, when the current was last not reversed */
    uint64_t seen;    /* us, when the current was last measured */
    uint64_t target_good;  /* us, when the target's voltage was last in its range */
    uint64_t battery_good; /* us, when the battery's was last measured and not too high */
    uint64_t battery_full; /* us, when it was last not too low */
    uint64_t bounce;       /* us, when the last bounce of the feedback began */
    bool flowed;      /* current has flowed since the closing */
    bool started;     /* the port has a voltage: a live one, or a dead one that took current long enough */
    bool dropped_out; /* the contactor opened on its own: a pulled plug, a fuse */
} dc_stage;

/* Everything off. */
void dc_stage_reset(dc_stage *stage, const dc_hardware *hardware, const dc_config *config, uint64_t now);

/* Start closing within `limits`; only from DC_OPEN. */
void dc_stage_close(dc_stage *stage, uint64_t now, const dc_limits *limits);

/* Open: with `ramp` reduce the current below 1 A first (at most 50 ms), otherwise open at once. Always allowed. */
void dc_stage_open(dc_stage *stage, uint64_t now, bool ramp);

/* Advance with the measurements at `now` and return the detected fault, 0 = none. The caller opens on a fault. */
uint8_t dc_stage_step(dc_stage *stage, uint64_t now, const dc_power_reading *reading);

#ifdef __cplusplus
}
#endif

#endif
