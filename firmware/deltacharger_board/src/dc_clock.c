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
    /* The OpenCM core's micros() can step back by a millisecond if its tick interrupts the reading. Treated as a
     * wrap, that would add 71 minutes: a lost heartbeat and a wrong device time. */
    if (elapsed <= UINT32_MAX / 2u) {
        clock->now += elapsed;
        clock->last = counter;
    }
    return clock->now;
}
