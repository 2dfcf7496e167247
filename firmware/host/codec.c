/* SPDX-License-Identifier: Apache-2.0 */
/* The codec alone, over standard input and output, for tests against another implementation.
 *
 * Request: u8 operation, u32 size, body. Answer: u32 size, body. Little-endian.
 *   r  u16 capacity                                     new decoder         -> nothing
 *   d  bytes of a stream                                decode              -> packets, see put_packet
 *   c  nothing                                          counters            -> u32 x 6, i16
 *   e  u8 type, u16 sequence, u64 time, u8 flags, u8 format, payload        -> bytes on the wire
 *   s  200 f32                                          samples             -> payload
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "dc_bytes.h"
#include "dc_packet.h"
#include "dc_payload.h"

#define LARGEST (1u << 22)

static uint8_t body[LARGEST], answer[2 * LARGEST];
static dc_decoder decoder;

/* u16 size of the payload, then the fields of `e`. */
static size_t put_packet(uint8_t *to, const dc_packet *packet)
{
    dc_put_u16(to, packet->size);
    to[2] = packet->type;
    dc_put_u16(to + 3, packet->sequence);
    dc_put_u64(to + 5, packet->device_time_us);
    to[13] = packet->flags;
    to[14] = packet->format;
    memcpy(to + 15, packet->payload, packet->size);
    return 15u + packet->size;
}

static void new_decoder(uint16_t capacity)
{
    free(decoder.buffer); /* exactly the given size, so that a sanitizer detects an access beyond it */
    dc_decoder_init(&decoder, malloc(capacity), capacity);
}

static size_t decode(size_t size)
{
    size_t used = 0;
    for (size_t i = 0; i < size; i++) {
        dc_packet packet;
        if (dc_decoder_put(&decoder, body[i], &packet))
            used += put_packet(answer + used, &packet);
    }
    return used;
}

static size_t encode(size_t size)
{
    const dc_packet packet = {
        .type = body[0],
        .sequence = dc_get_u16(body + 1),
        .device_time_us = dc_get_u64(body + 3),
        .flags = body[11],
        .format = body[12],
        .payload = body + 13,
        .size = (uint16_t)(size - 13u),
    };
    uint8_t *wire = malloc(DC_WIRE_SIZE(size - 13u));
    const size_t length = dc_packet_encode(&packet, wire);
    memcpy(answer, wire, length);
    free(wire);
    return length;
}

static size_t samples(void)
{
    float forces[DC_TAXELS];
    for (size_t i = 0; i < DC_TAXELS; i++)
        forces[i] = dc_get_f32(body + 4 * i);
    return dc_put_samples(answer, forces);
}

static size_t counters(void)
{
    const dc_decoder_counters *met = &decoder.counters;
    dc_put_u32(answer, met->packets);
    dc_put_u32(answer + 4, met->cobs_errors);
    dc_put_u32(answer + 8, met->crc_errors);
    dc_put_u32(answer + 12, met->length_errors);
    dc_put_u32(answer + 16, met->version_errors);
    dc_put_u32(answer + 20, met->header_errors);
    dc_put_u16(answer + 24, (uint16_t)met->refused_version);
    return 26;
}

static size_t serve(int operation, size_t size)
{
    switch (operation) {
    case 'r':
        new_decoder(dc_get_u16(body));
        return 0;
    case 'd':
        return decode(size);
    case 'c':
        return counters();
    case 'e':
        return encode(size);
    case 's':
        return samples();
    default:
        fprintf(stderr, "unknown operation %d\n", operation);
        exit(2);
    }
}

int main(void)
{
    uint8_t head[5];
    new_decoder(1024);
    while (fread(head, 1, sizeof head, stdin) == sizeof head) {
        const size_t size = dc_get_u32(head + 1);
        if (size > LARGEST || fread(body, 1, size, stdin) != size)
            return 2;
        const size_t length = serve(head[0], size);
        dc_put_u32(head, (uint32_t)length);
        fwrite(head, 1, 4, stdout);
        fwrite(answer, 1, length, stdout);
        fflush(stdout);
    }
    free(decoder.buffer);
    return 0;
}
