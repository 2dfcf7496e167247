/* SPDX-License-Identifier: Apache-2.0 */
/* Both tactile arrays: sampling, the tare, dead taxels. */
#ifndef DC_PADS_H
#define DC_PADS_H

#include <stdbool.h>
#include <stdint.h>

#include "dc_hardware.h"

#ifdef __cplusplus
extern "C" {
#endif

#define DC_CONTACT_FORCE 1.0f   /* N; one live taxel at or above it is contact */
#define DC_TARE_SAMPLES 8u
#define DC_TARE_PERIOD_US 4000u /* 28 ms in all */

typedef struct {
    bool tared;               /* a tare is subtracted */
    uint8_t taken;            /* samples of the running tare */
    uint64_t tare_due;        /* us, DC_NEVER if none is running */
    float baseline[DC_TAXELS]; /* N; NaN = unknown: no tare yet, or dead in every sample of it */
    float sum[DC_TAXELS];      /* N, of the running tare */
    uint8_t live[DC_TAXELS];   /* samples in `sum` */
} dc_pads;

/* Result of a tare. */
typedef enum { DC_TARE_NONE, DC_TARE_DONE, DC_TARE_REFUSED } dc_tare_result;

void dc_pads_reset(dc_pads *pads);

/* Subtract the tare from raw forces: NaN if dead or without a baseline in the tare; dc_put_samples clips values
 * below 0. */
void dc_pads_apply(const dc_pads *pads, float forces[DC_TAXELS]);

/* Start a tare; false if one is running or something touches a pad. */
bool dc_pads_start_tare(dc_pads *pads, const dc_hardware *hardware, uint64_t now);

/* Take the tare's due sample, and return whether it has ended. */
dc_tare_result dc_pads_poll_tare(dc_pads *pads, const dc_hardware *hardware, uint64_t now);

/* Return whether any live taxel carries DC_CONTACT_FORCE or more after the present tare. */
bool dc_pads_loaded(const dc_pads *pads, const float raw[DC_TAXELS]);

#ifdef __cplusplus
}
#endif

#endif
