/* SPDX-License-Identifier: Apache-2.0 */
/* Interlocks and automatic openings of the contactor: heartbeat, probe, latched faults. Energy never depends on a live
 * host. */
#ifndef DC_CONTACTOR_H
#define DC_CONTACTOR_H

#include <stdbool.h>
#include <stdint.h>

#include "dc_stage.h"

#ifdef __cplusplus
extern "C" {
#endif

#define DC_HEARTBEAT_TIMEOUT_US 100000u
#define DC_HEARTBEAT_MARGIN_US 10000u /* the longest part of it that a slow poll may take */
#define DC_PROBE_LIFETIME_US 2000000u /* during which an answer allows a close */
#define DC_PROBE_TIMEOUT_US 250000u   /* longest time until a probe is answered */
#define DC_LIVE_VOLTAGE 1.0f          /* V that electrodes have without being driven if a battery is connected to them */
#define DC_SHORT_RESISTANCE 1.0f      /* ohm, below it the electrodes are shorted */
#define DC_STAGE_TOLERANCE 0.1f       /* V that a trimmed stage may have above a closing's voltage */
#define DC_DEAD_VOLTAGE 5.0f          /* V, below it the electrodes are dead */
#define DC_CHECK_PERIOD_US 1000u      /* between readings of the active power stage */
#define DC_IDLE_CHECK_PERIOD_US 10000u

/* Outcome of a probe. */
typedef enum { DC_PROBE_NONE, DC_PROBE_DONE, DC_PROBE_ABORTED } dc_probe_event;

/* What lies at the electrodes. */
typedef enum { DC_PORT_UNKNOWN, DC_PORT_OPEN, DC_PORT_DEAD, DC_PORT_LIVE, DC_PORT_SHORT, DC_PORT_REVERSED } dc_port;

typedef struct {
    dc_stage stage;
    bool closed;   /* a close was accepted and no opening followed; the stage may still pre-charge */
    uint8_t fault; /* latched until the next opening command, a weld until it is cleared; 0 = none */
    bool probing;
    bool probe_aborted;          /* not answered yet */
    uint64_t probe_answer_due;   /* us, latest answer to the running probe */
    dc_port port;                /* what the last answer found */
    uint64_t probe_valid_until;  /* us, until when that counts */
    uint64_t heartbeat_deadline; /* us */
    uint64_t next_check;         /* us */
    dc_power_reading reading;    /* the last one */
    float sum, least;            /* A, of the currents measured since the last dc_contactor_report */
    float voltages;              /* V, sum of the target's voltages while current flowed */
    uint32_t measured, flowing;  /* their numbers */
} dc_contactor;

/* Boot: open, all state reset but a weld. */
void dc_contactor_reset(dc_contactor *contactor, const dc_hardware *hardware, const dc_config *config, uint64_t now);

void dc_contactor_heartbeat(dc_contactor *contactor, uint64_t now);

/* Close within `limits` if every interlock allows it; return DC_DONE, DC_INTERLOCK or DC_NOT_NOW. */
uint8_t dc_contactor_close(dc_contactor *contactor, uint64_t now, const dc_limits *limits);

/* Change the largest current, A, of a closed contactor; return DC_DONE or DC_NOT_NOW. */
uint8_t dc_contactor_limit(dc_contactor *contactor, float current);

/* Open as commanded, ramping down, and clear the latched fault, but no weld. */
void dc_contactor_open(dc_contactor *contactor, uint64_t now);

/* Clear a latched weld once contactor and electrodes are dead; return DC_DONE, DC_INTERLOCK or DC_NOT_NOW. */
uint8_t dc_contactor_clear_weld(dc_contactor *contactor);

/* Open at once and latch a fault; the first stays, but a weld replaces it. */
void dc_contactor_trip(dc_contactor *contactor, uint8_t fault, uint64_t now);

/* Start a probe; return DC_DONE (dc_contactor_poll_probe will return the result), DC_INTERLOCK or DC_NOT_NOW. */
uint8_t dc_contactor_start_probe(dc_contactor *contactor, uint64_t now);

/* Return whether the probe has ended; ohm and V are set with DC_PROBE_DONE. */
dc_probe_event dc_contactor_poll_probe(dc_contactor *contactor, uint64_t now, float *resistance, float *target);

/* Set mean and least current, A, of all checks since the last call, NaN if none measured it, and the target's voltage, V:
 * the mean while current flowed, so that the product is the power; the last one if none did. */
void dc_contactor_report(dc_contactor *contactor, float *mean, float *least, float *target);

/* Check the heartbeat and, if due, the power stage; then `reading` and `fault` are the content of POWER. */
void dc_contactor_poll(dc_contactor *contactor, uint64_t now);

/* Return when dc_contactor_poll or dc_contactor_poll_probe is due, us. */
uint64_t dc_contactor_next_event(const dc_contactor *contactor, uint64_t now);

#ifdef __cplusplus
}
#endif

#endif
