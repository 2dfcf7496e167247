/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_output.h"

#include <string.h>

void dc_output_clear(dc_output *output)
{
    output->first = output->used = 0;
}

bool dc_output_put(dc_output *output, const uint8_t *packet, size_t size, size_t leaves)
{
    if (size + leaves > (size_t)(DC_OUTPUT_SIZE - output->used))
        return false;
    const size_t end = (output->first + (size_t)output->used) % DC_OUTPUT_SIZE;
    const size_t straight = size < DC_OUTPUT_SIZE - end ? size : DC_OUTPUT_SIZE - end;
    memcpy(output->bytes + end, packet, straight);
    memcpy(output->bytes, packet + straight, size - straight);
    output->used = (uint16_t)(output->used + size);
    return true;
}

void dc_output_flush(dc_output *output, size_t (*write)(void *context, const uint8_t *bytes, size_t size),
                     void *context)
{
    while (output->used > 0) {
        const size_t straight = DC_OUTPUT_SIZE - (size_t)output->first;
        const size_t offered = output->used < straight ? output->used : straight;
        const size_t taken = write(context, output->bytes + output->first, offered);
        output->first = (uint16_t)((output->first + taken) % DC_OUTPUT_SIZE);
        output->used = (uint16_t)(output->used - taken);
        if (taken < offered)
            return;
    }
}
