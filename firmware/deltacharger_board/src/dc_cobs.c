/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_cobs.h"

#include <string.h>

#define FULL 0xFFu /* code of a run of 254 bytes, which no zero follows */

static void open_run(dc_cobs_encoder *encoder)
{
    encoder->out[encoder->code_at] = encoder->code;
    encoder->code_at = encoder->size++;
    encoder->code = 1;
}

void dc_cobs_begin(dc_cobs_encoder *encoder, uint8_t *out)
{
    encoder->out = out;
    encoder->size = 1;
    encoder->code_at = 0;
    encoder->code = 1;
}

void dc_cobs_put(dc_cobs_encoder *encoder, const uint8_t *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        if (encoder->code == FULL)
            open_run(encoder); /* only now: a full run at the very end needs no closing code */
        if (bytes[i] == 0) {
            open_run(encoder);
        } else {
            encoder->out[encoder->size++] = bytes[i];
            encoder->code++;
        }
    }
}

size_t dc_cobs_end(dc_cobs_encoder *encoder)
{
    encoder->out[encoder->code_at] = encoder->code;
    return encoder->size;
}

size_t dc_cobs_decode(uint8_t *bytes, size_t size)
{
    size_t position = 0, length = 0;
    while (position < size) {
        const uint8_t code = bytes[position];
        if (code == 0 || code > size - position || memchr(bytes + position, 0, code) != NULL)
            return DC_COBS_BAD;
        memmove(bytes + length, bytes + position + 1, (size_t)code - 1u);
        length += (size_t)code - 1u;
        position += code;
        if (code != FULL && position < size)
            bytes[length++] = 0; /* the zero replaces the run's code, so writing never overtakes reading */
    }
    return size == 0 ? DC_COBS_BAD : length;
}
