/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_packet.h"

#include <string.h>

#include "dc_bytes.h"
#include "dc_crc32.h"

void dc_count(uint32_t *counter, uint32_t more)
{
    *counter = more < UINT32_MAX - *counter ? *counter + more : UINT32_MAX;
}

static void write_header(const dc_packet *packet, uint8_t *header)
{
    header[0] = DC_VERSION;
    header[1] = packet->type;
    dc_put_u16(header + 2, packet->sequence);
    dc_put_u64(header + 4, packet->device_time_us);
    header[12] = packet->flags;
    header[13] = packet->format;
    dc_put_u16(header + 14, 0);
}

size_t dc_packet_encode(const dc_packet *packet, uint8_t *wire)
{
    uint8_t header[DC_HEADER_SIZE], checksum[DC_CRC_SIZE];
    write_header(packet, header);
    dc_put_u32(checksum, dc_crc32(dc_crc32(0, header, sizeof header), packet->payload, packet->size));
    dc_cobs_encoder encoder;
    dc_cobs_begin(&encoder, wire + 1);
    dc_cobs_put(&encoder, header, sizeof header);
    dc_cobs_put(&encoder, packet->payload, packet->size);
    dc_cobs_put(&encoder, checksum, sizeof checksum);
    const size_t stuffed = dc_cobs_end(&encoder);
    wire[0] = wire[stuffed + 1] = 0;
    return stuffed + 2;
}

void dc_decoder_init(dc_decoder *decoder, uint8_t *buffer, uint16_t capacity)
{
    memset(decoder, 0, sizeof *decoder);
    decoder->buffer = buffer;
    decoder->capacity = capacity;
    decoder->counters.refused_version = -1;
}

/* Decode a piece between delimiters, in place. */
static bool read_piece(dc_decoder *decoder, dc_packet *packet)
{
    dc_decoder_counters *counters = &decoder->counters;
    uint8_t *bytes = decoder->buffer;
    const size_t size = dc_cobs_decode(bytes, decoder->size);
    if (size == DC_COBS_BAD) {
        dc_count(&counters->cobs_errors, 1);
        return false;
    }
    if (size < DC_HEADER_SIZE + DC_CRC_SIZE) {
        dc_count(&counters->length_errors, 1);
        return false;
    }
    const size_t body = size - DC_CRC_SIZE;
    if (dc_crc32(0, bytes, body) != dc_get_u32(bytes + body)) {
        dc_count(&counters->crc_errors, 1);
        return false;
    }
    if (bytes[0] != DC_VERSION) {
        dc_count(&counters->version_errors, 1);
        counters->refused_version = bytes[0];
        return false;
    }
    if (dc_get_u16(bytes + 14) != 0) {
        dc_count(&counters->header_errors, 1);
        return false;
    }
    packet->type = bytes[1];
    packet->sequence = dc_get_u16(bytes + 2);
    packet->device_time_us = dc_get_u64(bytes + 4);
    packet->flags = bytes[12];
    packet->format = bytes[13];
    packet->payload = bytes + DC_HEADER_SIZE;
    packet->size = (uint16_t)(body - DC_HEADER_SIZE);
    dc_count(&counters->packets, 1);
    return true;
}

bool dc_decoder_put(dc_decoder *decoder, uint8_t byte, dc_packet *packet)
{
    if (byte != 0) {
        if (decoder->size < decoder->capacity)
            decoder->buffer[decoder->size++] = byte;
        else
            decoder->overlong = true;
        return false;
    }
    bool intact = false;
    if (decoder->overlong)
        dc_count(&decoder->counters.length_errors, 1);
    else if (decoder->size > 0)
        intact = read_piece(decoder, packet);
    decoder->overlong = false;
    decoder->size = 0;
    return intact;
}
