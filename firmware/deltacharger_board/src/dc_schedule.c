/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_schedule.h"

static uint64_t period_of(float rate)
{
    const double period = 1e6 / (double)rate;
    const uint32_t whole = (uint32_t)period;
    return (uint64_t)whole << 32 | (uint32_t)((period - (double)whole) * 4294967296.0);
}

static void advance(dc_schedule *schedule, uint64_t step)
{
    const uint64_t fraction = (uint64_t)schedule->due_fraction + (step & 0xFFFFFFFFu);
    schedule->due_us += (step >> 32) + (fraction >> 32);
    schedule->due_fraction = (uint32_t)(fraction & 0xFFFFFFFFu);
}

void dc_schedule_init(dc_schedule *schedule, float rate)
{
    schedule->period = period_of(rate);
    dc_schedule_stop(schedule);
}

void dc_schedule_set_rate(dc_schedule *schedule, float rate, uint64_t now)
{
    schedule->period = period_of(rate);
    if (schedule->due_us != DC_NEVER) {
        schedule->due_us = now;
        schedule->due_fraction = 0;
        advance(schedule, schedule->period);
    }
}

void dc_schedule_start(dc_schedule *schedule, uint64_t now)
{
    if (schedule->due_us == DC_NEVER) {
        schedule->due_us = now;
        schedule->due_fraction = 0;
    }
}

void dc_schedule_stop(dc_schedule *schedule)
{
    schedule->due_us = DC_NEVER;
    schedule->due_fraction = 0;
}

uint32_t dc_schedule_take(dc_schedule *schedule, uint64_t now)
{
    if (now < schedule->due_us)
        return 0;
    /* All instants whose microsecond has begun. The clock refuses steps of 2^31 us, so this fits into 64 bits. */
    const uint64_t behind = ((now - schedule->due_us) << 32) + (UINT32_MAX - schedule->due_fraction);
    const uint32_t come = (uint32_t)(behind / schedule->period) + 1u;
    advance(schedule, come * schedule->period);
    return come;
}
