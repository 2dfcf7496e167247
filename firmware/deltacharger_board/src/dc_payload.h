/* SPDX-License-Identifier: Apache-2.0 */
/* Payloads of the board link's packets as bytes (docs/board-link.md). Pure functions. */
#ifndef DC_PAYLOAD_H
#define DC_PAYLOAD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define DC_ROWS 10u
#define DC_COLUMNS 10u
#define DC_PAD (DC_ROWS * DC_COLUMNS) /* taxels of one pad */
#define DC_TAXELS (2u * DC_PAD)       /* left, then right */
#define DC_FULL_SCALE 10.0f           /* N, the code one below the top */

enum { DC_NO_FORMAT = 0, DC_U8, DC_U12, DC_U16 };

#define DC_POWER_SIZE 16u
#define DC_HELLO_SIZE 12u
#define DC_ACK_SIZE 4u /* without data */
#define DC_PROBE_DATA_SIZE 8u
#define DC_RATE_SIZE 4u

/* Write forces (N, row-major from the top row; NaN = dead, clipped to 0..10) in a format; return the bytes written:
 * 200, 300 or 400; 0 for an unknown format. */
size_t dc_put_samples(uint8_t *to, const float forces[DC_TAXELS], uint8_t format);

/* V, V, A (NaN = not measured), the contactor's own feedback, the latched fault. */
size_t dc_put_power(uint8_t *to, float battery, float target, float current, bool closed, uint8_t fault);

size_t dc_put_hello(uint8_t *to, uint8_t minor, uint32_t boot_id, float rate);
size_t dc_put_ack(uint8_t *to, uint8_t type, uint8_t error, uint16_t sequence);

#ifdef __cplusplus
}
#endif

#endif
