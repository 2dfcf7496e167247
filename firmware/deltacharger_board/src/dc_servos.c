/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_servos.h"

#include <string.h>

#define QUIET_BITS 200u     /* 20 bytes: longer than the pause between replies to one request */
#define SHORTEST_QUIET 200u /* us */

bool dc_servos_are_there(const dc_hardware *hardware)
{
    return hardware->servo_read != NULL && hardware->servo_write != NULL && hardware->servo_speed != NULL;
}

void dc_servos_reset(dc_servos *servos, const dc_hardware *hardware)
{
    memset(servos, 0, sizeof *servos);
    if (dc_servos_are_there(hardware))
        (void)dc_servos_set_speed(servos, hardware, DC_BAUD_RATE);
}

bool dc_servos_set_speed(dc_servos *servos, const dc_hardware *hardware, uint32_t speed)
{
    if (speed == 0 || !hardware->servo_speed(hardware->context, speed))
        return false;
    const uint32_t quiet = (uint32_t)(QUIET_BITS * UINT64_C(1000000) / speed);
    servos->quiet_us = quiet > SHORTEST_QUIET ? quiet : SHORTEST_QUIET;
    servos->in_size = servos->out_size = 0;
    return true;
}

bool dc_servos_put(dc_servos *servos, const uint8_t *bytes, size_t size)
{
    if (size > DC_LONGEST_SERVO || size > DC_SERVO_ROOM - (size_t)servos->out_size)
        return false;
    servos->asked = true;
    memcpy(servos->out + servos->out_size, bytes, size);
    servos->out_size = (uint16_t)(servos->out_size + size);
    return true;
}

/* Bytes are dropped until the host has sent some: a host that does not know the bus gets none. */
static void gather(dc_servos *servos, const dc_hardware *hardware, uint64_t now)
{
    const size_t room = DC_LONGEST_SERVO - (size_t)servos->in_size;
    const size_t came = hardware->servo_read(hardware->context, servos->in + servos->in_size, room);
    if (came > 0)
        servos->came_us = now;
    servos->in_size = servos->asked ? (uint16_t)(servos->in_size + came) : 0u;
}

static void send(dc_servos *servos, const dc_hardware *hardware)
{
    if (servos->out_size == 0)
        return;
    const size_t taken = hardware->servo_write(hardware->context, servos->out, servos->out_size);
    servos->out_size = (uint16_t)(servos->out_size - taken);
    memmove(servos->out, servos->out + taken, servos->out_size);
}

size_t dc_servos_poll(dc_servos *servos, const dc_hardware *hardware, uint64_t now)
{
    if (!dc_servos_are_there(hardware))
        return 0;
    gather(servos, hardware, now);
    send(servos, hardware); /* last: it takes time, and received bytes would then be older than `now` indicates */
    const bool full = servos->in_size == DC_LONGEST_SERVO;
    return full || now - servos->came_us >= servos->quiet_us ? servos->in_size : 0;
}

uint64_t dc_servos_next_event(const dc_servos *servos, uint64_t now)
{
    const uint64_t in = servos->in_size > 0 ? servos->came_us + servos->quiet_us : UINT64_MAX;
    const uint64_t out = servos->out_size > 0 ? now + servos->quiet_us : UINT64_MAX;
    return in < out ? in : out;
}
