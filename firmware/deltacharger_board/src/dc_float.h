/* SPDX-License-Identifier: Apache-2.0 */
/* Tests of floats by their bits: cheap without a floating-point unit, correct under -ffast-math. */
#ifndef DC_FLOAT_H
#define DC_FLOAT_H

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#define DC_NAN (dc_float_of_bits(0x7FC00000u))

static inline float dc_float_of_bits(uint32_t bits)
{
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline uint32_t dc_bits_of_float(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static inline bool dc_is_nan(float value)
{
    return (dc_bits_of_float(value) & 0x7FFFFFFFu) > 0x7F800000u;
}

static inline bool dc_is_finite(float value)
{
    return (dc_bits_of_float(value) & 0x7FFFFFFFu) < 0x7F800000u;
}

/* True for -0 too; undefined for NaN. */
static inline bool dc_is_negative(float value)
{
    return dc_bits_of_float(value) >> 31 != 0;
}

/* Clears the sign bit; a NaN stays a NaN. */
static inline float dc_absolute(float value)
{
    return dc_float_of_bits(dc_bits_of_float(value) & 0x7FFFFFFFu);
}

#endif
