/* SPDX-License-Identifier: Apache-2.0 */
/* Evenly spaced instants without drift: the period keeps 2^-32 us, so 120 Hz is off by less than 3e-14 of itself. */
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
    uint64_t due_us;       /* DC_NEVER while it rests */
    uint32_t due_fraction; /* 2^-32 us */
} dc_schedule;

/* Rest, at a rate in Hz; above 0 and at most 1e6. */
void dc_schedule_init(dc_schedule *schedule, float rate);

/* Change the rate; a running schedule goes on one new period after `now`. */
void dc_schedule_set_rate(dc_schedule *schedule, float rate, uint64_t now);

/* Begin at `now`; one that runs already goes on undisturbed. */
void dc_schedule_start(dc_schedule *schedule, uint64_t now);

void dc_schedule_stop(dc_schedule *schedule);

/* Return how many instants have come since the last call, and move on to the next. */
uint32_t dc_schedule_take(dc_schedule *schedule, uint64_t now);

#ifdef __cplusplus
}
#endif

#endif
