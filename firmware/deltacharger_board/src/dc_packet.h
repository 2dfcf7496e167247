/* SPDX-License-Identifier: Apache-2.0 */
/* Packets of the board link: framing, header, checksum and constants of the protocol (docs/board-link.md). */
#ifndef DC_PACKET_H
#define DC_PACKET_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "dc_cobs.h"

#ifdef __cplusplus
extern "C" {
#endif

#define DC_VERSION 1u
#define DC_MINOR 2u       /* from which a close carries limits */
#define DC_SERVO_MINOR 3u /* of a board that passes the bytes of the servos' bus */
#define DC_HEADER_SIZE 16u
#define DC_CRC_SIZE 4u
#define DC_LONGEST_PING 64u     /* bytes */
#define DC_LONGEST_PAYLOAD 300u /* bytes, sent by the board: TACTILE */

/* Largest size on the wire of a packet with `payload` bytes, both delimiters included. */
#define DC_WIRE_SIZE(payload) (DC_COBS_SIZE(DC_HEADER_SIZE + (payload) + DC_CRC_SIZE) + 2u)

/* Longest stuffed packet that the board accepts from the host; the longest of version 1 has 149 bytes. */
#define DC_LONGEST_RECEIVED 256u

enum {
    DC_TACTILE = 1,
    DC_POWER,
    DC_HELLO,
    DC_START,
    DC_STOP,
    DC_TARE,
    DC_RATE,
    DC_CONTACTOR,
    DC_PING,
    DC_ACK,
    DC_PROBE,
    DC_HEARTBEAT,
    DC_SERVO,
    DC_SERVO_SPEED,
    DC_TYPES /* one more than the last */
};

enum { DC_DONE = 0, DC_BAD_PAYLOAD, DC_UNKNOWN, DC_INTERLOCK, DC_NOT_NOW };

enum {
    DC_NO_FAULT = 0,
    DC_NO_CHARGE_CURRENT,
    DC_SHORT_CIRCUIT,
    DC_STALE,
    DC_REVERSE_POLARITY,
    DC_VOLTAGE_OUT_OF_RANGE,
    DC_REVERSE_CURRENT,
    DC_CONTACTOR_WELDED,
    DC_HEARTBEAT_LOST,
    DC_OVER_CURRENT
};

enum { DC_FLAG_TARED = 1, DC_FLAG_OVERRUN = 2 };

typedef struct {
    const uint8_t *payload;
    uint16_t size;           /* of the payload, bytes */
    uint16_t sequence;       /* counts packets per direction and type, modulo 65536 */
    uint64_t device_time_us; /* since the board booted; 0 from the host */
    uint8_t type;
    uint8_t flags;  /* DC_FLAG_* */
    uint8_t format; /* sample format of a TACTILE payload, else 0 */
} dc_packet;

/* Write the bytes for the wire, delimiters included; return their number, at most DC_WIRE_SIZE(packet->size). */
size_t dc_packet_encode(const dc_packet *packet, uint8_t *wire);

/* Counts of a decoder. They only rise, and stop at their maximum. */
typedef struct {
    uint32_t packets;
    uint32_t cobs_errors;
    uint32_t crc_errors;
    uint32_t length_errors;
    uint32_t version_errors;
    uint32_t header_errors;  /* intact packets whose reserved bytes are not 0 */
    int16_t refused_version; /* the last one refused, -1 = none */
} dc_decoder_counters;

/* Cuts a byte stream into packets, however it is split and whatever lies between them. A piece that is not an intact
 * packet is counted and dropped; decoding resumes at the next delimiter. */
typedef struct {
    uint8_t *buffer;
    uint16_t capacity; /* longest stuffed packet, bytes */
    uint16_t size;
    bool overlong; /* the piece was longer than the buffer; skip the rest up to its delimiter */
    dc_decoder_counters counters;
} dc_decoder;

void dc_decoder_init(dc_decoder *decoder, uint8_t *buffer, uint16_t capacity);

/* Take the next byte. True if it completes an intact packet, which is valid until the next byte. */
bool dc_decoder_put(dc_decoder *decoder, uint8_t byte, dc_packet *packet);

/* Add `more`; a counter stops at its maximum. */
void dc_count(uint32_t *counter, uint32_t more);

#ifdef __cplusplus
}
#endif

#endif
