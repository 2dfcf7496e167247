/* SPDX-License-Identifier: Apache-2.0 */
/* Evenly spaced instants without drift: with a resolution of 2^-32 us, the error at 120 Hz is below 3e-14. */
#ifndef DC_SCHEDULE_H
#define DC_SCHEDULE_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define DC_NEVER UINT64_MAX /* us */

typedef struct {
    uint64_t period;       /* 2^-32 us */
    uint64_t due_us;       /* DC_NEVER while stopped */
    uint32_t due_fraction; /* 2^-32 us */
} dc_schedule;

/* Initialise, stopped, at a rate in Hz; above 0 and at most 1e6. */
void dc_schedule_init(dc_schedule *schedule, float rate);

/* Change the rate; a running schedule continues one new period after `now`. */
void dc_schedule_set_rate(dc_schedule *schedule, float rate, uint64_t now);

/* Start at `now`; a running schedule is not changed. */
void dc_schedule_start(dc_schedule *schedule, uint64_t now);

void dc_schedule_stop(dc_schedule *schedule);

/* Return the number of instants since the last call, and advance to the next. */
uint32_t dc_schedule_take(dc_schedule *schedule, uint64_t now);

#ifdef __cplusplus
}
#endif

#endif
