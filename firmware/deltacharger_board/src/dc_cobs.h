/* SPDX-License-Identifier: Apache-2.0 */
/* Consistent overhead byte stuffing (Cheshire and Baker, 1999): any bytes, without the byte zero. */
#ifndef DC_COBS_H
#define DC_COBS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Most bytes that stuffing `size` bytes can take. */
#define DC_COBS_SIZE(size) ((size) + (size) / 254u + 1u)

/* What dc_cobs_decode returns for bytes that no encoder produces. */
#define DC_COBS_BAD ((size_t)-1)

/* An encoder that is given its bytes piece by piece, so that nobody has to join them first. */
typedef struct {
    uint8_t *out;    /* room for DC_COBS_SIZE of all that is put */
    size_t size;     /* bytes in `out`, the open run's code included */
    size_t code_at;  /* where the open run's code goes */
    uint8_t code;    /* length of the open run plus one */
} dc_cobs_encoder;

void dc_cobs_begin(dc_cobs_encoder *encoder, uint8_t *out);
void dc_cobs_put(dc_cobs_encoder *encoder, const uint8_t *bytes, size_t size);

/* Close the last run and return how many bytes lie in `out`; at least 1, without delimiters. */
size_t dc_cobs_end(dc_cobs_encoder *encoder);

/* Unstuff `size` bytes in place and return how many are left, or DC_COBS_BAD. */
size_t dc_cobs_decode(uint8_t *bytes, size_t size);

#ifdef __cplusplus
}
#endif

#endif
