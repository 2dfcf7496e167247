/* SPDX-License-Identifier: Apache-2.0 */
/* The board of docs/board-link.md, between hardware hooks and the bytes of the link; one entry that never waits.
 *
 *     static dc_board board;
 *     dc_board_boot(&board, &hardware, &config, boot_id);
 *     for (;;)
 *         dc_board_poll(&board);
 */
#ifndef DC_BOARD_H
#define DC_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "dc_clock.h"
#include "dc_contactor.h"
#include "dc_hardware.h"
#include "dc_output.h"
#include "dc_packet.h"
#include "dc_pads.h"
#include "dc_payload.h"
#include "dc_schedule.h"
#include "dc_servos.h"

#ifdef __cplusplus
extern "C" {
#endif

#define DC_DEFAULT_RATE 120.0f /* Hz, after every boot */
#define DC_SLOWEST_RATE 0.1f   /* Hz, lower limit of RATE */
#define DC_FASTEST_RATE 1000.0f
#define DC_POWER_PERIOD_US 50000u

/* For a debugger; the link does not send them. They only rise, and stop at their maximum. */
typedef struct {
    uint32_t unknown_types;   /* packets of unknown types */
    uint32_t missed_samples;  /* instants of the schedule without a poll in time */
    uint32_t dropped_tactile; /* packets for which the output had no room */
    uint32_t dropped_power;
    uint32_t dropped_answers;
    uint32_t dropped_servo;
} dc_board_counters;

typedef struct {
    const dc_hardware *hardware;
    dc_config config;
    dc_clock clock;
    dc_decoder decoder;
    dc_output output;
    dc_schedule samples;
    dc_pads pads;
    dc_contactor contactor;
    dc_servos servos;
    dc_board_counters counters;
    uint32_t boot_id;
    float rate;          /* Hz */
    uint64_t next_power; /* us */
    bool overrun;        /* samplings were lost since the last sent one */
    uint16_t sequences[DC_TYPES];
    uint16_t probe_sequence; /* of the packet waiting for an answer */
    uint16_t tare_sequence;
    uint8_t received[DC_LONGEST_RECEIVED];
} dc_board;

/* Switch everything off, reset all state, queue HELLO. `boot_id` differs at each boot. `hardware` must stay valid. */
void dc_board_boot(dc_board *board, const dc_hardware *hardware, const dc_config *config, uint32_t boot_id);

/* Do everything due, the contactor first. Never waits; call it at least every config.poll_period. */
void dc_board_poll(dc_board *board);

/* Return the time from the last poll until the next is needed, us, apart from reading: the caller may sleep so long. */
uint32_t dc_board_idle_us(const dc_board *board);

#ifdef __cplusplus
}
#endif

#endif
