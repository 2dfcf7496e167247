/* SPDX-License-Identifier: Apache-2.0 */
/* The servos' bus on the board's own connector: one data line for both directions. */
#ifndef SERVO_BUS_H
#define SERVO_BUS_H

#include <stddef.h>
#include <stdint.h>

/* Listen on the bus. */
void servos_begin();

/* Hooks of dc_hardware. */
size_t servos_read(void *context, uint8_t *bytes, size_t size);
size_t servos_write(void *context, const uint8_t *bytes, size_t size);
bool servos_speed(void *context, uint32_t speed);

#endif
