/* SPDX-License-Identifier: Apache-2.0 */
/* Consistent overhead byte stuffing (Cheshire and Baker, 1999): encodes any bytes without the byte zero. */
#ifndef DC_COBS_H
#define DC_COBS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Largest size of `size` bytes when stuffed. */
#define DC_COBS_SIZE(size) ((size) + (size) / 254u + 1u)

/* Result of dc_cobs_decode for invalid bytes. */
#define DC_COBS_BAD ((size_t)-1)

/* An encoder that takes its bytes in pieces, so that the caller need not join them. */
typedef struct {
    uint8_t *out;    /* room for DC_COBS_SIZE of all bytes put */
    size_t size;     /* bytes in `out`, the open run's code included */
    size_t code_at;  /* position of the open run's code */
    uint8_t code;    /* length of the open run plus one */
} dc_cobs_encoder;

void dc_cobs_begin(dc_cobs_encoder *encoder, uint8_t *out);
void dc_cobs_put(dc_cobs_encoder *encoder, const uint8_t *bytes, size_t size);

/* Close the last run and return the number of bytes in `out`, without delimiters; at least 1. */
size_t dc_cobs_end(dc_cobs_encoder *encoder);

/* Unstuff `size` bytes in place and return the new size, or DC_COBS_BAD. */
size_t dc_cobs_decode(uint8_t *bytes, size_t size);

#ifdef __cplusplus
}
#endif

#endif
