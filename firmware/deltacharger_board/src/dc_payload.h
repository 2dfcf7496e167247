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

enum { DC_NO_FORMAT = 0, DC_U12 = 2 };

#define DC_POWER_SIZE 20u
#define DC_HELLO_SIZE 20u
#define DC_ACK_SIZE 4u /* without data */
#define DC_PROBE_DATA_SIZE 8u
#define DC_RATE_SIZE 4u
#define DC_CLOSE_SIZE 20u
#define DC_LIMIT_SIZE 5u

/* The first byte of CONTACTOR. */
enum { DC_COMMAND_OPEN = 0, DC_COMMAND_CLOSE, DC_COMMAND_CLEAR_WELD, DC_COMMAND_LIMIT };

/* Limits within which one closing may charge. */
typedef struct {
    float current;     /* A at most */
    float voltage;     /* V at most */
    bool dead;         /* the port may have no voltage of its own */
    uint32_t start_us; /* from the closing until current flows */
    uint32_t gap_us;   /* without current once it has flowed */
} dc_limits;

/* Write forces (N, row-major from the top row; NaN = dead, clipped to 0..10) as DC_U12; return the bytes written, 300. */
size_t dc_put_samples(uint8_t *to, const float forces[DC_TAXELS]);

/* V, V, mean and least A (NaN = not measured), the contactor's own feedback, the latched fault. */
size_t dc_put_power(uint8_t *to, float battery, float target, float current, float least, bool closed, uint8_t fault);

/* `stage_voltage`: constant voltage of the stage, V; NaN = the board sets it. */
size_t dc_put_hello(uint8_t *to, uint8_t minor, uint32_t boot_id, float rate, bool steps_up, float stage_voltage);
size_t dc_put_ack(uint8_t *to, uint8_t type, uint8_t error, uint16_t sequence);

/* Read the limits of a CONTACTOR that closes, DC_CLOSE_SIZE bytes; false if one is not a number or out of its bounds. */
bool dc_get_close(const uint8_t *from, dc_limits *limits);

/* Read the current, A, of a CONTACTOR that changes it, DC_LIMIT_SIZE bytes; false like dc_get_close. */
bool dc_get_limit(const uint8_t *from, float *current);

#ifdef __cplusplus
}
#endif

#endif
