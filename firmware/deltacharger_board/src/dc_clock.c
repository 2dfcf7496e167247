/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_clock.h"

#include <stdint.h>

void dc_clock_start(dc_clock *clock, uint32_t counter)
{
    clock->last = counter;
    clock->now = 0;
}

uint64_t dc_clock_update(dc_clock *clock, uint32_t counter)
{
    const uint32_t elapsed = counter - clock->last;
    /* The OpenCM core's micros() can fall back by a millisecond where its tick interrupts the reading. Taken for a
     * wrap, that would be 71 minutes: a lost heartbeat and a false device time. */
    if (elapsed <= UINT32_MAX / 2u) {
        clock->now += elapsed;
        clock->last = counter;
    }
    return clock->now;
}
