/* SPDX-License-Identifier: Apache-2.0 */
/* Packets for the host: a ring buffer that takes complete packets and never waits.
 *
 * If the wire is slow, less important packets must leave more room: TACTILE is refused first, SERVO next, then POWER.
 * The last bytes are reserved for answers to commands. */
#ifndef DC_OUTPUT_H
#define DC_OUTPUT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define DC_OUTPUT_SIZE 1536u    /* bytes: 15 ms of wire at 1 Mbaud */
#define DC_TACTILE_LEAVES 768u  /* bytes that TACTILE must leave free; the rest holds two packets in u12, one in u16 */
#define DC_SERVO_LEAVES 448u    /* bytes that SERVO must leave free: a bus that is always busy must not block POWER */
#define DC_POWER_LEAVES 384u    /* bytes that POWER must leave free, 14 ACKs; they last half a second */

typedef struct {
    uint16_t first; /* the oldest byte */
    uint16_t used;
    uint8_t bytes[DC_OUTPUT_SIZE];
} dc_output;

void dc_output_clear(dc_output *output);

/* Queue a complete packet; false, without a change, if fewer than `leaves` bytes would stay free. */
bool dc_output_put(dc_output *output, const uint8_t *packet, size_t size, size_t leaves);

/* Pass bytes to `write`, which returns the number accepted and never waits. */
void dc_output_flush(dc_output *output, size_t (*write)(void *context, const uint8_t *bytes, size_t size),
                     void *context);

#ifdef __cplusplus
}
#endif

#endif
