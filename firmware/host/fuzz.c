/* SPDX-License-Identifier: Apache-2.0 */
/* Fuzz test of the decoder and of the complete board with damaged and random bytes; run it with sanitizers.
 *
 *     fuzz [PACKETS] [SEED]
 *
 * Decoder: every accepted packet must have been sent. Board: whatever the host does, the contactor is commanded only
 * while a heartbeat is fresh, never together with the probe, never with a latched fault, and never above the limits of
 * board and closing; a weld stays until a host clears it; the servos get no byte that the host did not send. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "console.h"
#include "dc_bytes.h"

#define AT_ONCE 16u /* packets that are damaged together */
#define LONGEST_PLAIN 520u
#define ROUND_US 600000000u /* simulated time before a board is booted again */

static uint64_t random_state;

static uint32_t any(uint32_t below)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 32) % below;
}

static void fail(const char *what)
{
    fprintf(stderr, "fuzz: %s\n", what);
    exit(1);
}

/* Flip, cut, insert, repeat or zero bytes; return the new size. */
static size_t damage(uint8_t *bytes, size_t size, size_t room)
{
    const size_t at = any((uint32_t)size);
    const size_t length = 1u + any(40);
    switch (any(6)) {
    case 0:
        bytes[at] ^= (uint8_t)(1u << any(8));
        return size;
    case 1:
        return at;
    case 2:
        bytes[at] = 0;
        return size;
    case 3:
        bytes[at] = (uint8_t)any(256);
        return size;
    case 4:
        if (at + length > size)
            return size;
        memmove(bytes + at, bytes + at + length, size - at - length);
        return size - length;
    default:
        if (size + length > room)
            return size;
        memmove(bytes + at + length, bytes + at, size - at);
        for (size_t i = 0; i < length; i++)
            bytes[at + i] = (uint8_t)any(256);
        return size + length;
    }
}

static dc_packet draw_packet(uint8_t *payload, uint8_t types)
{
    dc_packet packet = {0};
    packet.type = (uint8_t)any(types);
    packet.sequence = (uint16_t)any(65536);
    packet.device_time_us = (uint64_t)any(UINT32_MAX) << 32 | any(UINT32_MAX);
    packet.flags = (uint8_t)any(4);
    packet.format = (uint8_t)any(5);
    packet.size = (uint16_t)(any(3) ? any(10) : any(LONGEST_PLAIN));
    packet.payload = payload;
    const uint32_t zeros = 1u + any(16);
    for (size_t i = 0; i < packet.size; i++)
        payload[i] = any(zeros) ? (uint8_t)any(256) : 0;
    return packet;
}

static bool same(const dc_packet *a, const dc_packet *b)
{
    return a->type == b->type && a->sequence == b->sequence && a->device_time_us == b->device_time_us &&
           a->flags == b->flags && a->format == b->format && a->size == b->size &&
           memcmp(a->payload, b->payload, a->size) == 0;
}

/* Pass a byte to the decoder and count accepted packets, which must be among the `count` sent ones. */
static unsigned long put(dc_decoder *decoder, uint8_t byte, const dc_packet *sent, size_t count)
{
    dc_packet got;
    if (!dc_decoder_put(decoder, byte, &got))
        return 0;
    for (size_t i = 0; i < count; i++)
        if (same(&got, &sent[i]))
            return 1;
    fail("accepted a packet that was not sent");
    return 0;
}

/* Send some packets, damaged or not, and return how many were accepted. */
static unsigned long fuzz_decoder(dc_decoder *decoder)
{
    static uint8_t payloads[AT_ONCE][LONGEST_PLAIN], wire[DC_WIRE_SIZE(LONGEST_PLAIN) + 64u];
    dc_packet sent[AT_ONCE];
    unsigned long accepted = 0;
    for (size_t i = 0; i < AT_ONCE; i++) {
        sent[i] = draw_packet(payloads[i], 255);
        size_t size = dc_packet_encode(&sent[i], wire);
        for (uint32_t times = any(4); times > 0 && size > 0; times--)
            size = damage(wire, size, sizeof wire);
        for (size_t k = 0; k < size; k++)
            accepted += put(decoder, wire[k], sent, i + 1);
    }
    return accepted + put(decoder, 0, sent, AT_ONCE); /* the last may have lost its delimiter */
}

static void check_board(const struct console *console, uint64_t heartbeat)
{
    const struct bench *bench = &console->bench;
    const dc_contactor *contactor = &console->board.contactor;
    if (bench->outputs.contactor && bench->probing)
        fail("probe and battery on the electrodes");
    if (bench->outputs.current_limit > console->config.current_limit || bench->outputs.current_limit < 0.0f)
        fail("current limit out of range");
    const dc_stage *stage = &contactor->stage;
    if (bench->outputs.contactor && (bench->outputs.current_limit > stage->limits.current ||
                                     bench->outputs.voltage > stage->limits.voltage))
        fail("more current or voltage than the closing allows");
    if (!stage->started && bench->outputs.current_limit > DC_START_CURRENT)
        fail("a dead port gets more than its first current");
    if (contactor->closed && bench->now - heartbeat >= DC_HEARTBEAT_TIMEOUT_US)
        fail("closed without a heartbeat");
    if (contactor->closed && contactor->fault != DC_NO_FAULT)
        fail("closed with a latched fault");
    if (bench->outputs.contactor && !contactor->closed && contactor->stage.state != DC_RAMPING_DOWN)
        fail("contactor on without a command");
    if (console->board.output.used > DC_OUTPUT_SIZE)
        fail("output overflows");
    if (console->board.servos.in_size > DC_LONGEST_SERVO || console->board.servos.out_size > DC_SERVO_ROOM)
        fail("more servo bytes than there is room for");
}

/* A latched weld goes only after a command that clears it, and with what is stored. */
static void check_weld(const struct console *console, const dc_packet *packet, bool was)
{
    static bool asked;
    const bool welded = console->board.contactor.fault == DC_CONTACTOR_WELDED;
    asked = was && (asked || (packet->type == DC_CONTACTOR && packet->size == 1 && packet->payload[0] == 2));
    if (was && !welded && !asked)
        fail("a weld was forgotten");
    if (welded != (console->bench.stored == DC_CONTACTOR_WELDED))
        fail("the stored byte is wrong");
}

/* Receive random bytes from the servos, or none; remove the bytes sent to them. */
static void vary_bus(struct console *console, const dc_packet *packet)
{
    struct bench *bench = &console->bench;
    static uint64_t promised; /* bytes of SERVO that may still reach the servos */
    promised += packet->type == DC_SERVO ? packet->size : 0u;
    if (bench->to_servos_used > promised)
        fail("the servos got bytes that were not sent to them");
    promised -= bench->to_servos_used;
    bench->to_servos_used = 0;
    bench->bus_takes = any(3) ? BENCH_BUS : any(40);
    for (uint32_t more = any(4) ? 0u : any(400); more > 0 && bench->from_servos_used < BENCH_BUS; more--)
        bench->from_servos[bench->from_servos_used++] = (uint8_t)any(256);
}

/* A payload of CONTACTOR: mostly a close, whose limits are sometimes out of their bounds. */
static uint16_t draw_contactor(uint8_t *payload)
{
    static const float LIMITS[4][4] = {
        {18.0f, 2.0f, 0.05f, 31.0f}, {29.4f, 25.2f, 60.0f, 0.5f}, {3.0f, 0.1f, 70.0f, NAN}, {0.2f, 0.05f, 130.0f, -1.0f},
    };
    const uint32_t kind = any(32);
    memset(payload, 0, DC_CLOSE_SIZE);
    payload[0] = kind < 6 ? DC_COMMAND_OPEN : DC_COMMAND_CLEAR_WELD;
    if (kind < 10)
        return 1;
    if (kind < 12) {
        payload[0] = DC_COMMAND_LIMIT;
        dc_put_f32(payload + 1, LIMITS[0][any(4)]);
        return DC_LIMIT_SIZE;
    }
    payload[0] = DC_COMMAND_CLOSE;
    payload[1] = any(4) == 0;
    for (size_t i = 0; i < 4; i++)
        dc_put_f32(payload + 4 + 4 * i, LIMITS[i][any(any(8) ? 2 : 4)]);
    return DC_CLOSE_SIZE;
}

/* A packet that a host could send, sometimes with random content. */
static dc_packet draw_command(uint8_t *payload)
{
    static const uint8_t TYPES[] = {3, 4, 5, 6, 7, 8, 8, 8, 9, 11, 11, 12, 12, 12, 12, 12, 13, 13, 14};
    dc_packet packet = {0};
    if (any(20) == 0)
        return draw_packet(payload, 15);
    packet.type = TYPES[any(sizeof TYPES)];
    packet.sequence = (uint16_t)any(65536);
    packet.payload = payload;
    if (packet.type == DC_CONTACTOR)
        packet.size = draw_contactor(payload);
    else if (packet.type == DC_RATE || packet.type == DC_PING || packet.type == DC_SERVO_SPEED)
        packet.size = 4;
    else if (packet.type == DC_SERVO)
        packet.size = (uint16_t)any(140);
    for (size_t i = packet.type == DC_CONTACTOR ? packet.size : 0u; i < packet.size; i++)
        payload[i] = (uint8_t)any(256);
    if (packet.type == DC_SERVO_SPEED)
        dc_put_u32(payload, any(5) ? 9600u << any(9) : any(UINT32_MAX));
    return packet;
}

static void vary_bench(struct bench *bench)
{
    static const float RESISTANCES[] = {0.5f, 2.0f, 2.0f, 2.0f, 50.0f, INFINITY};
    bench->resistance = RESISTANCES[any(6)];
    bench->target = any(10) ? 24.0f : any(2) ? 0.0f : (float)any(80) - 40.0f;
    bench->dropped = any(20) == 0;
    for (size_t i = 0; i < BENCH_READINGS; i++) {
        bench->is_forced[i] = any(60) == 0;
        bench->forced[i] = any(2) ? NAN : (float)any(60) - 30.0f;
    }
    bench->detected = any(10) ? 0u : (uint8_t)any(10);
    bench->welded = any(20) == 0;
    bench->stuck = any(20) == 0;
    bench->baud = any(4) ? 0u : any(2000000);
    bench->probe_time = any(4) ? any(200000) : UINT32_MAX;
    bench->load[any(DC_TAXELS)] = (float)any(12);
    bench->dead[any(DC_TAXELS)] = any(2) != 0;
}

/* One random step of a host. */
static void fuzz_board(struct console *console, uint64_t *heartbeat)
{
    static uint8_t payload[LONGEST_PLAIN];
    struct bench *bench = &console->bench;
    const dc_packet packet = draw_command(payload);
    size_t size = dc_packet_encode(&packet, bench->input);
    if (any(8) == 0)
        size = damage(bench->input, size, sizeof bench->input);
    bench->input_used = size;
    bench->input_read = 0;
    if (any(100) == 0)
        vary_bench(bench);
    const uint64_t before = console->board.contactor.heartbeat_deadline;
    const bool welded = bench->stored == DC_CONTACTOR_WELDED;
    bench->now += any(3) ? any(5000) : any(60000);
    dc_board_poll(&console->board);
    if (console->board.contactor.heartbeat_deadline != before)
        *heartbeat = bench->now;
    check_board(console, *heartbeat);
    check_weld(console, &packet, welded);
    vary_bus(console, &packet);
    bench->output_used = 0;
}

int main(int count, char **arguments)
{
    static struct console console;
    static uint8_t buffer[1024];
    const unsigned long packets = count > 1 ? strtoul(arguments[1], NULL, 10) : 1000000u;
    const uint64_t seed = count > 2 ? strtoull(arguments[2], NULL, 10) : 1u;
    unsigned long accepted = 0, closes = 0;
    uint64_t heartbeat = 0;
    random_state = seed * 2654435769u + 88172645463325252u;
    dc_decoder decoder;
    dc_decoder_init(&decoder, buffer, sizeof buffer);
    for (unsigned long done = 0; done < packets; done += AT_ONCE)
        accepted += fuzz_decoder(&decoder);
    for (unsigned long done = 0; done < packets; done++) {
        if (done == 0 || console.bench.now > ROUND_US) {
            console_init(&console, 0, seed + done, true, any(4) != 0);
            console.bench.noise = 0.0f;
            heartbeat = 0;
        }
        const bool closed = console.board.contactor.closed;
        fuzz_board(&console, &heartbeat);
        closes += !closed && console.board.contactor.closed;
    }
    printf("decoder: %lu packets, %lu accepted, all of them sent; board: %lu packets, %lu closes, every rule kept\n",
           packets, accepted, packets, closes);
    return 0;
}
