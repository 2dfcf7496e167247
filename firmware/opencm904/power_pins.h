/* SPDX-License-Identifier: Apache-2.0 */
/* The power stage and the probe on the pins of board_wiring.h. */
#ifndef POWER_PINS_H
#define POWER_PINS_H

#include <dc_hardware.h>

/* Configure the output pins, off before they drive anything. */
void power_begin();

/* Hooks of dc_hardware. */
void power_read(void *context, dc_power_reading *reading);
void power_drive(void *context, const dc_power_outputs *outputs);
void probe_start(void *context);
bool probe_poll(void *context, float *resistance, float *target);
void probe_stop(void *context);

#endif
