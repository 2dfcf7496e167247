/* SPDX-License-Identifier: Apache-2.0 */
/* Time since boot in 64 bits from a 32-bit microsecond counter that wraps every 71.6 minutes. */
#ifndef DC_CLOCK_H
#define DC_CLOCK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    uint32_t last; /* the counter at its last advance */
    uint64_t now;  /* us since the start */
} dc_clock;

void dc_clock_start(dc_clock *clock, uint32_t counter);

/* Return us since the start; call it at least every 35 minutes. */
uint64_t dc_clock_update(dc_clock *clock, uint32_t counter);

#ifdef __cplusplus
}
#endif

#endif
