/* SPDX-License-Identifier: Apache-2.0 */
#include "bench.h"

#include <math.h>
#include <string.h>

#define PRECHARGE_TIME 60000u /* us */
#define PULL_IN_TIME 5000u
#define WIRE_BUFFER 128u      /* bytes that a transmitter takes beyond the one it is sending */

void bench_init(struct bench *bench, uint64_t now, uint64_t seed)
{
    memset(bench, 0, sizeof *bench);
    bench->now = now;
    bench->random = seed * 2654435769u + 88172645463325252u;
    bench->offset = 0.12f;
    bench->noise = 0.02f;
    bench->battery = 26.0f;
    bench->target = 24.0f;
    bench->resistance = 2.0f;
    bench->probe_time = 150000;
    bench->bus_takes = BENCH_BUS;
}

uint32_t bench_random(struct bench *bench)
{
    bench->random ^= bench->random << 13;
    bench->random ^= bench->random >> 7;
    bench->random ^= bench->random << 17;
    return (uint32_t)(bench->random >> 32);
}

static float gaussian(struct bench *bench)
{
    float sum = -6.0f; /* twelve uniform numbers have variance 1 */
    for (int i = 0; i < 12; i++)
        sum += (float)(bench_random(bench) >> 8) / 16777216.0f;
    return sum;
}

bool bench_closed(struct bench *bench)
{
    const bool pulled = bench->outputs.contactor && !bench->dropped && bench->now >= bench->pulled_in;
    if (pulled && !bench->stuck)
        bench->closed = true;
    else if (!pulled && !bench->welded && bench->now >= bench->released)
        bench->closed = false;
    return bench->closed;
}

/* V of the stage without a load. */
static float stage_voltage(const struct bench *bench)
{
    const dc_config *config = bench->config;
    const float voltage = isnan(config->stage_voltage) ? bench->outputs.voltage : config->stage_voltage;
    return !config->steps_up && bench->battery < voltage ? bench->battery : voltage;
}

float bench_current(const struct bench *bench)
{
    const float limit = bench->outputs.current_limit;
    if (!bench->closed)
        return 0.0f;
    const float driven = (stage_voltage(bench) - bench->target) / bench->resistance;
    return driven > limit ? limit : driven > 0.0f ? driven : 0.0f;
}

static uint32_t now_us(void *context)
{
    return (uint32_t)(((struct bench *)context)->now & 0xFFFFFFFFu);
}

static size_t read_input(void *context, uint8_t *bytes, size_t size)
{
    struct bench *bench = context;
    const size_t left = bench->input_used - bench->input_read;
    const size_t count = size < left ? size : left;
    memcpy(bytes, bench->input + bench->input_read, count);
    bench->input_read += count;
    return count;
}

/* Number of bytes that the transmitter accepts now. */
static size_t wire_room(struct bench *bench)
{
    if (bench->baud == 0)
        return BENCH_OUTPUT;
    if (bench->baud == 1)
        return 0;
    const uint64_t busy = bench->wire_free > bench->now ? bench->wire_free - bench->now : 0;
    const uint64_t waiting = busy * bench->baud / 10000000u;
    return waiting < WIRE_BUFFER ? (size_t)(WIRE_BUFFER - waiting) : 0;
}

static size_t write_output(void *context, const uint8_t *bytes, size_t size)
{
    struct bench *bench = context;
    size_t count = wire_room(bench);
    if (count > size)
        count = size;
    if (count > BENCH_OUTPUT - bench->output_used)
        count = BENCH_OUTPUT - bench->output_used;
    memcpy(bench->output + bench->output_used, bytes, count);
    bench->output_used += count;
    if (bench->baud > 1) {
        if (bench->wire_free < bench->now)
            bench->wire_free = bench->now;
        bench->wire_free += count * 10000000u / bench->baud;
    }
    return count;
}

static void read_taxels(void *context, float forces[DC_TAXELS])
{
    struct bench *bench = context;
    for (size_t i = 0; i < DC_TAXELS; i++) {
        const float noise = bench->noise > 0.0f ? bench->noise * gaussian(bench) : 0.0f;
        forces[i] = bench->dead[i] ? NAN : bench->load[i] + bench->offset + noise;
    }
    bench->now += bench->scan_time;
}

static float output_voltage(const struct bench *bench)
{
    if (bench->closed || bench->now >= bench->precharged)
        return bench->target;
    return bench->outputs.precharge ? 0.5f * bench->target : 0.0f;
}

static void read_power(void *context, dc_power_reading *reading)
{
    struct bench *bench = context;
    reading->contactor_closed = bench_closed(bench);
    reading->battery = bench->battery;
    const float alone = bench->closed ? stage_voltage(bench) : NAN;
    reading->target = isinf(bench->resistance) ? alone : bench->target;
    reading->output = output_voltage(bench);
    reading->current = bench_current(bench);
    reading->fault = bench->detected;
    float *const readings[] = {&reading->current, &reading->target, &reading->output, &reading->battery};
    for (size_t i = 0; i < sizeof readings / sizeof *readings; i++)
        if (bench->is_forced[i])
            *readings[i] = bench->forced[i];
    if (bench->is_forced[BENCH_READINGS - 1u])
        reading->contactor_closed = bench->forced[BENCH_READINGS - 1u] > 0.0f;
}

static void set_outputs(void *context, const dc_power_outputs *outputs)
{
    struct bench *bench = context;
    const bool opens = bench->outputs.contactor && !outputs->contactor && !bench->welded;
    if (opens && bench_closed(bench) && bench_current(bench) > bench->broken)
        bench->broken = bench_current(bench);
    if (outputs->precharge && !bench->outputs.precharge)
        bench->precharged = bench->now + PRECHARGE_TIME;
    else if (!outputs->precharge)
        bench->precharged = UINT64_MAX;
    if (outputs->contactor && !bench->outputs.contactor)
        bench->pulled_in = bench->now + PULL_IN_TIME;
    if (!outputs->contactor && bench->outputs.contactor) {
        bench->switched_off = bench->now;
        bench->released = bench->now + bench->release_time;
    }
    bench->outputs = *outputs;
    (void)bench_closed(bench);
}

static void start_probe(void *context)
{
    struct bench *bench = context;
    bench->probing = true;
    bench->probe_due = bench->probe_time == UINT32_MAX ? UINT64_MAX : bench->now + bench->probe_time;
}

static bool poll_probe(void *context, float *resistance, float *target)
{
    struct bench *bench = context;
    if (!bench->probing || bench->now < bench->probe_due)
        return false;
    const bool nothing = isinf(bench->resistance);
    *target = nothing ? 0.0f : bench->target;
    *resistance = !nothing && fabsf(bench->target) >= DC_LIVE_VOLTAGE ? NAN : bench->resistance;
    if (bench->answers) {
        *resistance = bench->ohm;
        *target = bench->volt;
    }
    return true;
}

static void stop_probe(void *context)
{
    ((struct bench *)context)->probing = false;
}

static uint8_t load(void *context)
{
    return ((struct bench *)context)->stored;
}

static void save(void *context, uint8_t value)
{
    ((struct bench *)context)->stored = value;
}

static size_t read_servos(void *context, uint8_t *bytes, size_t size)
{
    struct bench *bench = context;
    const size_t count = size < bench->from_servos_used ? size : bench->from_servos_used;
    memcpy(bytes, bench->from_servos, count);
    bench->from_servos_used -= count;
    memmove(bench->from_servos, bench->from_servos + count, bench->from_servos_used);
    return count;
}

static size_t write_servos(void *context, const uint8_t *bytes, size_t size)
{
    struct bench *bench = context;
    const size_t room = BENCH_BUS - bench->to_servos_used;
    const size_t takes = bench->bus_takes < room ? bench->bus_takes : room;
    const size_t count = size < takes ? size : takes;
    memcpy(bench->to_servos + bench->to_servos_used, bytes, count);
    bench->to_servos_used += count;
    return count;
}

static bool set_servo_speed(void *context, uint32_t speed)
{
    struct bench *bench = context;
    if (speed < 9600u || speed > 4500000u)
        return false;
    bench->servo_speed = speed;
    bench->from_servos_used = 0;
    return true;
}

dc_hardware bench_hardware(struct bench *bench, bool servos)
{
    const dc_hardware hardware = {
        .context = bench,
        .now_us = now_us,
        .read = read_input,
        .write = write_output,
        .read_taxels = read_taxels,
        .read_power = read_power,
        .set_outputs = set_outputs,
        .start_probe = start_probe,
        .poll_probe = poll_probe,
        .stop_probe = stop_probe,
        .load = load,
        .save = save,
        .servo_read = servos ? read_servos : NULL,
        .servo_write = servos ? write_servos : NULL,
        .servo_speed = servos ? set_servo_speed : NULL,
    };
    return hardware;
}
