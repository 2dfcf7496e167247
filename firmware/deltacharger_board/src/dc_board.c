/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_board.h"

#include <string.h>

#include "dc_bytes.h"

#define READ_PER_POLL 64u    /* bytes, two or three packets; limits the duration of one poll */
#define FLUSH_PERIOD_US 250u /* 25 bytes of wire at 1 Mbaud */

/* Result of a command that sends its answer itself, later. */
#define LATER 0xFFu

static uint64_t now_us(dc_board *board)
{
    return dc_clock_update(&board->clock, board->hardware->now_us(board->hardware->context));
}

/* Number a packet and queue it. Temporary data is on the stack: the 20 kB of an OpenCM 9.04 have no room for static
 * buffers. */
static bool queue(dc_board *board, dc_packet *packet, size_t leaves)
{
    uint8_t wire[DC_WIRE_SIZE(DC_LONGEST_PAYLOAD)];
    packet->sequence = board->sequences[packet->type]++;
    return dc_output_put(&board->output, wire, dc_packet_encode(packet, wire), leaves);
}

/* Queue a packet with the next sequence number of its type and the present time; false if the output is full. */
static bool send(dc_board *board, uint8_t type, const uint8_t *payload, uint16_t size)
{
    dc_packet packet = {0};
    packet.type = type;
    packet.payload = payload;
    packet.size = size;
    packet.device_time_us = board->clock.now;
    const bool sent = queue(board, &packet,
                            type == DC_POWER   ? DC_POWER_LEAVES
                            : type == DC_SERVO ? DC_SERVO_LEAVES
                                               : 0u);
    if (!sent)
        dc_count(type == DC_POWER   ? &board->counters.dropped_power
                 : type == DC_SERVO ? &board->counters.dropped_servo
                                    : &board->counters.dropped_answers,
                 1);
    return sent;
}

/* Queue an ACK with `size` bytes of data. */
static void acknowledge(dc_board *board, uint8_t type, uint16_t sequence, uint8_t error, const uint8_t *data,
                        uint16_t size)
{
    uint8_t payload[DC_ACK_SIZE + DC_PROBE_DATA_SIZE];
    const size_t head = dc_put_ack(payload, type, error, sequence);
    if (size > 0)
        memcpy(payload + head, data, size);
    (void)send(board, DC_ACK, payload, (uint16_t)(head + size));
}

static void introduce(dc_board *board)
{
    uint8_t payload[DC_HELLO_SIZE];
    const uint8_t minor = dc_servos_are_there(board->hardware) ? DC_SERVO_MINOR : DC_MINOR;
    const size_t size = dc_put_hello(payload, minor, board->boot_id, board->rate, board->config.steps_up,
                                     board->config.stage_voltage);
    (void)send(board, DC_HELLO, payload, (uint16_t)size);
}

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
        introduce(board);
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

/* Execute a packet from the host and answer it. */
static void obey(dc_board *board, const dc_packet *packet)
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
            (void)send(board, DC_PING, packet->payload, packet->size);
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
        acknowledge(board, packet->type, packet->sequence, error, NULL, 0);
}

void dc_board_boot(dc_board *board, const dc_hardware *hardware, const dc_config *config, uint32_t boot_id)
{
    board->hardware = hardware;
    board->config = *config;
    dc_contactor_reset(&board->contactor, hardware, &board->config, 0); /* off before anything else */
    dc_clock_start(&board->clock, hardware->now_us(hardware->context));
    dc_decoder_init(&board->decoder, board->received, sizeof board->received);
    dc_output_clear(&board->output);
    dc_schedule_init(&board->samples, DC_DEFAULT_RATE);
    dc_pads_reset(&board->pads);
    dc_servos_reset(&board->servos, hardware);
    memset(&board->counters, 0, sizeof board->counters);
    memset(board->sequences, 0, sizeof board->sequences);
    board->boot_id = boot_id;
    board->rate = DC_DEFAULT_RATE;
    board->next_power = DC_POWER_PERIOD_US;
    board->overrun = false;
    board->probe_sequence = board->tare_sequence = 0;
    introduce(board);
}

/* Answer the probe and the tare if they have ended. */
static void finish(dc_board *board)
{
    float resistance, target;
    uint8_t data[DC_PROBE_DATA_SIZE];
    switch (dc_contactor_poll_probe(&board->contactor, board->clock.now, &resistance, &target)) {
    case DC_PROBE_DONE:
        dc_put_f32(data, resistance);
        dc_put_f32(data + 4, target);
        acknowledge(board, DC_PROBE, board->probe_sequence, DC_DONE, data, sizeof data);
        break;
    case DC_PROBE_ABORTED:
        acknowledge(board, DC_PROBE, board->probe_sequence, DC_NOT_NOW, NULL, 0);
        break;
    case DC_PROBE_NONE:
        break;
    }
    switch (dc_pads_poll_tare(&board->pads, board->hardware, board->clock.now)) {
    case DC_TARE_DONE:
        acknowledge(board, DC_TARE, board->tare_sequence, DC_DONE, NULL, 0);
        break;
    case DC_TARE_REFUSED:
        acknowledge(board, DC_TARE, board->tare_sequence, DC_NOT_NOW, NULL, 0);
        break;
    case DC_TARE_NONE:
        break;
    }
    dc_contactor_poll(&board->contactor, now_us(board)); /* a tare may have sampled */
}

/* Sample if an instant of the schedule has come. Missed instants cannot be sampled any more: their sequence numbers
 * are skipped, and the next frame is flagged. */
static void stream(dc_board *board)
{
    const uint32_t come = dc_schedule_take(&board->samples, board->clock.now);
    if (come == 0)
        return;
    dc_count(&board->counters.missed_samples, come - 1);
    board->sequences[DC_TACTILE] = (uint16_t)(board->sequences[DC_TACTILE] + (come - 1));
    board->overrun = board->overrun || come > 1;
    float forces[DC_TAXELS];
    uint8_t payload[DC_LONGEST_PAYLOAD];
    dc_packet packet = {0};
    packet.type = DC_TACTILE;
    packet.device_time_us = now_us(board); /* the actual sampling instant, not the due time */
    board->hardware->read_taxels(board->hardware->context, forces);
    dc_pads_apply(&board->pads, forces);
    packet.payload = payload;
    packet.size = (uint16_t)dc_put_samples(payload, forces);
    packet.format = DC_U12;
    packet.flags = (uint8_t)((board->pads.tared ? DC_FLAG_TARED : 0) | (board->overrun ? DC_FLAG_OVERRUN : 0));
    board->overrun = !queue(board, &packet, DC_TACTILE_LEAVES);
    if (board->overrun)
        dc_count(&board->counters.dropped_tactile, 1);
}

static void report_power(dc_board *board)
{
    const uint64_t now = board->clock.now;
    if (now < board->next_power)
        return;
    board->next_power += (1u + (now - board->next_power) / DC_POWER_PERIOD_US) * DC_POWER_PERIOD_US;
    const dc_power_reading *reading = &board->contactor.reading; /* not older than 10 ms */
    uint8_t payload[DC_POWER_SIZE];
    float mean, least, target;
    dc_contactor_report(&board->contactor, &mean, &least, &target);
    const size_t size = dc_put_power(payload, reading->battery, target, mean, least, reading->contactor_closed,
                                     board->contactor.fault);
    (void)send(board, DC_POWER, payload, (uint16_t)size);
}

static void receive(dc_board *board)
{
    uint8_t bytes[READ_PER_POLL];
    const size_t count = board->hardware->read(board->hardware->context, bytes, sizeof bytes);
    for (size_t i = 0; i < count; i++) {
        dc_packet packet;
        if (!dc_decoder_put(&board->decoder, bytes[i], &packet))
            continue;
        obey(board, &packet);
        dc_contactor_poll(&board->contactor, now_us(board)); /* a TARE may have sampled */
        finish(board); /* an opening ends a probe: answer it before the next PROBE replaces it */
    }
}

static void pass_servos(dc_board *board)
{
    const size_t size = dc_servos_poll(&board->servos, board->hardware, now_us(board));
    if (size == 0)
        return;
    (void)send(board, DC_SERVO, board->servos.in, (uint16_t)size);
    board->servos.in_size = 0;
}

void dc_board_poll(dc_board *board)
{
    dc_contactor_poll(&board->contactor, now_us(board));
    finish(board);
    stream(board);
    /* Sampling took time: check the heartbeat's deadline before reading one that arrived too late. Checks after each
     * sampling are closer than 10 ms, which DC_HEARTBEAT_MARGIN_US needs. */
    dc_contactor_poll(&board->contactor, now_us(board));
    report_power(board);
    receive(board);
    pass_servos(board);
    dc_output_flush(&board->output, board->hardware->write, board->hardware->context);
}

static uint64_t earlier(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

uint32_t dc_board_idle_us(const dc_board *board)
{
    const uint64_t now = board->clock.now;
    uint64_t due = earlier(board->next_power, board->samples.due_us);
    due = earlier(due, board->pads.tare_due);
    due = earlier(due, dc_servos_next_event(&board->servos, now));
    due = earlier(due, dc_contactor_next_event(&board->contactor, now));
    if (board->output.used > 0)
        due = earlier(due, now + FLUSH_PERIOD_US);
    if (due <= now)
        return 0;
    return (uint32_t)earlier(due - now, 1000000u);
}
