/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_payload.h"

#include "dc_bytes.h"
#include "dc_float.h"
#include "dc_packet.h"

#define FULL_SCALE_BITS 0x41200000u /* of 10.0f; non-negative floats are ordered like their bits */

/* Rounds half to even, as IEEE 754. Uses integers: a Cortex-M3 has no floating-point unit, and this runs 200 times per
 * frame. `scaled` is not negative and below 65535. */
static uint16_t nearest(float scaled)
{
    const uint32_t bits = dc_bits_of_float(scaled);
    const uint32_t exponent = bits >> 23;
    if (exponent < 126u)
        return 0; /* below one half */
    const uint32_t mantissa = (bits & 0x7FFFFFu) | 0x800000u;
    const uint32_t shift = 150u - exponent; /* 8 to 24 */
    const uint32_t whole = mantissa >> shift, half = 1u << (shift - 1u);
    const uint32_t rest = mantissa & ((1u << shift) - 1u);
    return (uint16_t)(whole + (rest > half || (rest == half && (whole & 1u)) ? 1u : 0u));
}

static uint16_t code_of(float force, uint16_t top, float scale)
{
    if (dc_is_nan(force))
        return top;
    if (dc_is_negative(force))
        return 0;
    if (dc_bits_of_float(force) >= FULL_SCALE_BITS)
        return (uint16_t)(top - 1u);
    return nearest(force * scale);
}

size_t dc_put_samples(uint8_t *to, const float forces[DC_TAXELS])
{
    const uint16_t top = 0xFFFu;
    const float scale = (float)(top - 1u) / DC_FULL_SCALE;
    for (size_t i = 0; i < DC_TAXELS; i += 2, to += 3) {
        const uint16_t a = code_of(forces[i], top, scale), b = code_of(forces[i + 1], top, scale);
        to[0] = (uint8_t)(a & 0xFFu);
        to[1] = (uint8_t)(a >> 8 | (b & 15u) << 4);
        to[2] = (uint8_t)(b >> 4);
    }
    return DC_TAXELS * 3u / 2u;
}

size_t dc_put_power(uint8_t *to, float battery, float target, float current, float least, bool closed, uint8_t fault)
{
    dc_put_f32(to, battery);
    dc_put_f32(to + 4, target);
    dc_put_f32(to + 8, current);
    to[12] = closed ? 1u : 0u;
    to[13] = fault;
    dc_put_u16(to + 14, 0);
    dc_put_f32(to + 16, least);
    return DC_POWER_SIZE;
}

size_t dc_put_hello(uint8_t *to, uint8_t minor, uint32_t boot_id, float rate, bool steps_up, float stage_voltage)
{
    to[0] = DC_VERSION;
    to[1] = minor;
    to[2] = DC_ROWS;
    to[3] = DC_COLUMNS;
    dc_put_u32(to + 4, boot_id);
    dc_put_f32(to + 8, rate);
    to[12] = steps_up ? 1u : 0u;
    to[13] = 0;
    dc_put_u16(to + 14, 0);
    dc_put_f32(to + 16, stage_voltage);
    return DC_HELLO_SIZE;
}

size_t dc_put_ack(uint8_t *to, uint8_t type, uint8_t error, uint16_t sequence)
{
    to[0] = type;
    to[1] = error;
    dc_put_u16(to + 2, sequence);
    return DC_ACK_SIZE;
}

/* Read a f32 within its bounds; false for NaN too. */
static bool get_within(const uint8_t *from, float low, float high, float *value)
{
    *value = dc_get_f32(from);
    return *value >= low && *value <= high;
}

static bool get_current(const uint8_t *from, float *current)
{
    return get_within(from, 0.05f, 30.0f, current);
}

bool dc_get_close(const uint8_t *from, dc_limits *limits)
{
    float start, gap;
    if (from[0] != DC_COMMAND_CLOSE || from[1] > 1 || dc_get_u16(from + 2) != 0)
        return false;
    if (!get_current(from + 4, &limits->current) || !get_within(from + 8, 1.0f, 60.0f, &limits->voltage) ||
        !get_within(from + 12, 0.1f, 70.0f, &start) || !get_within(from + 16, 0.05f, 130.0f, &gap))
        return false;
    limits->dead = from[1] == 1;
    limits->start_us = (uint32_t)(start * 1e6f);
    limits->gap_us = (uint32_t)(gap * 1e6f);
    return true;
}

bool dc_get_limit(const uint8_t *from, float *current)
{
    return from[0] == DC_COMMAND_LIMIT && get_current(from + 1, current);
}
