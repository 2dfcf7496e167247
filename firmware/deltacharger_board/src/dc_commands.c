/* SPDX-License-Identifier: Apache-2.0 */
/* Commands: the action for each packet from the host. */
#include "dc_board.h"
#include "dc_bytes.h"

/* Result of a command that sends its answer itself, later. */
#define LATER 0xFFu

static uint8_t start_tare(dc_board *board, const dc_packet *packet)
{
    if (!dc_pads_start_tare(&board->pads, board->hardware, board->clock.now))
        return DC_NOT_NOW;
    board->tare_sequence = packet->sequence;
    return LATER;
}

static uint8_t start_probe(dc_board *board, const dc_packet *packet)
{
    const uint8_t error = dc_contactor_start_probe(&board->contactor, board->clock.now);
    if (error != DC_DONE)
        return error;
    board->probe_sequence = packet->sequence;
    return LATER;
}

static uint8_t set_rate(dc_board *board, const dc_packet *packet)
{
    if (packet->size != DC_RATE_SIZE)
        return DC_BAD_PAYLOAD;
    const float rate = dc_get_f32(packet->payload);
    if (!(rate >= DC_SLOWEST_RATE && rate <= DC_FASTEST_RATE)) /* also refuses NaN */
        return DC_BAD_PAYLOAD;
    board->rate = rate;
    dc_schedule_set_rate(&board->samples, rate, board->clock.now);
    return DC_DONE;
}

static uint8_t set_servo_speed(dc_board *board, const dc_packet *packet)
{
    if (packet->size != DC_SERVO_SPEED_SIZE)
        return DC_BAD_PAYLOAD;
    return dc_servos_set_speed(&board->servos, board->hardware, dc_get_u32(packet->payload)) ? DC_DONE : DC_BAD_PAYLOAD;
}

static void send_to_servos(dc_board *board, const dc_packet *packet)
{
    if (packet->size > 0 && !dc_servos_put(&board->servos, packet->payload, packet->size))
        dc_count(&board->counters.dropped_servo, 1);
}

static uint8_t switch_contactor(dc_board *board, const dc_packet *packet)
{
    dc_contactor *contactor = &board->contactor;
    dc_limits limits;
    float current;
    switch (packet->size) {
    case 1:
        if (packet->payload[0] == DC_COMMAND_CLEAR_WELD)
            return dc_contactor_clear_weld(contactor);
        if (packet->payload[0] != DC_COMMAND_OPEN)
            return DC_BAD_PAYLOAD;
        dc_contactor_open(contactor, board->clock.now);
        return DC_DONE;
    case DC_LIMIT_SIZE:
        return dc_get_limit(packet->payload, &current) ? dc_contactor_limit(contactor, current) : DC_BAD_PAYLOAD;
    case DC_CLOSE_SIZE:
        if (dc_get_close(packet->payload, &limits))
            return dc_contactor_close(contactor, board->clock.now, &limits);
        return DC_BAD_PAYLOAD;
    default:
        return DC_BAD_PAYLOAD;
    }
}

/* Commands without a value. */
static uint8_t plain_command(dc_board *board, const dc_packet *packet)
{
    if (packet->size != 0)
        return DC_BAD_PAYLOAD;
    switch (packet->type) {
    case DC_HELLO:
        dc_board_introduce(board);
        return DC_DONE;
    case DC_START:
        dc_schedule_start(&board->samples, board->clock.now);
        return DC_DONE;
    case DC_STOP:
        dc_schedule_stop(&board->samples);
        return DC_DONE;
    case DC_TARE:
        return start_tare(board, packet);
    default:
        return start_probe(board, packet);
    }
}

void dc_board_obey(dc_board *board, const dc_packet *packet)
{
    const bool plain = packet->flags == 0 && packet->format == DC_NO_FORMAT; /* only TACTILE has either */
    const bool servos = packet->type == DC_SERVO || packet->type == DC_SERVO_SPEED;
    uint8_t error;
    switch (servos && !dc_servos_are_there(board->hardware) ? DC_TYPES : packet->type) {
    case DC_SERVO:
        if (plain)
            send_to_servos(board, packet);
        return;
    case DC_SERVO_SPEED:
        error = plain ? set_servo_speed(board, packet) : DC_BAD_PAYLOAD;
        break;
    case DC_HEARTBEAT:
        if (plain && packet->size == 0)
            dc_contactor_heartbeat(&board->contactor, board->clock.now);
        return;
    case DC_PING:
        if (plain && packet->size <= DC_LONGEST_PING)
            (void)dc_board_send(board, DC_PING, packet->payload, packet->size);
        return;
    case DC_HELLO:
    case DC_START:
    case DC_STOP:
    case DC_TARE:
    case DC_PROBE:
        error = plain ? plain_command(board, packet) : DC_BAD_PAYLOAD;
        break;
    case DC_RATE:
        error = plain ? set_rate(board, packet) : DC_BAD_PAYLOAD;
        break;
    case DC_CONTACTOR:
        error = plain ? switch_contactor(board, packet) : DC_BAD_PAYLOAD;
        break;
    default:
        dc_count(&board->counters.unknown_types, 1);
        error = DC_UNKNOWN;
        break;
    }
    if (error != LATER)
        dc_board_acknowledge(board, packet->type, packet->sequence, error, NULL, 0);
}
