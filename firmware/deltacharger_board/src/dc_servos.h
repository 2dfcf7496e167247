/* SPDX-License-Identifier: Apache-2.0 */
/* The servos' bus behind the board: passes bytes of the host on, and gathers replies into packets. Their meaning
 * concerns only the host and the servos. */
#ifndef DC_SERVOS_H
#define DC_SERVOS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "dc_hardware.h"

#ifdef __cplusplus
extern "C" {
#endif

#define DC_LONGEST_SERVO 128u /* bytes of the bus in one packet */
#define DC_SERVO_ROOM 384u    /* bytes that may wait for the bus: three packets can arrive while pads are sampled */
#define DC_SERVO_SPEED_SIZE 4u
#define DC_BAUD_RATE 1000000u /* bit/s of the bus after every boot */

typedef struct {
    bool asked;        /* the host has sent bytes since the boot: it uses the bus */
    uint16_t out_size; /* bytes that wait for the bus */
    uint16_t in_size;  /* bytes that wait for the link */
    uint32_t quiet_us; /* without a byte, after which the received ones form a packet */
    uint64_t came_us;  /* arrival of the last byte */
    uint8_t out[DC_SERVO_ROOM];
    uint8_t in[DC_LONGEST_SERVO];
} dc_servos;

/* Discard all bytes, as a boot does. */
void dc_servos_reset(dc_servos *servos, const dc_hardware *hardware);

/* Return whether the board has this bus. */
bool dc_servos_are_there(const dc_hardware *hardware);

/* Set the speed of the bus, bit/s, and discard waiting bytes; false, without a change, if it is not supported. */
bool dc_servos_set_speed(dc_servos *servos, const dc_hardware *hardware, uint32_t speed);

/* Take bytes from the host for the bus; false, taking none, if not all fit: half a packet is useless. */
bool dc_servos_put(dc_servos *servos, const uint8_t *bytes, size_t size);

/* Move bytes both ways; return how many of `in` form a packet now, 0 = none. The caller that takes them sets
 * in_size to 0. */
size_t dc_servos_poll(dc_servos *servos, const dc_hardware *hardware, uint64_t now);

/* Return when the next poll is due, us; UINT64_MAX = never. */
uint64_t dc_servos_next_event(const dc_servos *servos, uint64_t now);

#ifdef __cplusplus
}
#endif

#endif
