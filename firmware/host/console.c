/* SPDX-License-Identifier: Apache-2.0 */
#include "console.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "dc_bytes.h"

#define MOST_POLLS 1000 /* at one instant */

void console_boot(struct console *console)
{
    const uint32_t boot_id = bench_random(&console->bench) | 1u;
    dc_board_boot(&console->board, &console->hardware, &console->config, boot_id);
}

void console_init(struct console *console, uint64_t now, uint64_t seed, bool stepped, bool servos)
{
    const dc_config config = DC_DEFAULT_CONFIG;
    bench_init(&console->bench, now, seed);
    console->bench.config = &console->board.config;
    console->hardware = bench_hardware(&console->bench, servos);
    console->config = config;
    console->stepped = stepped;
    console_boot(console);
}

/* Poll until nothing is due at this instant. */
static void settle(struct console *console)
{
    const uint64_t instant = console->bench.now;
    for (int polls = 0; polls < MOST_POLLS; polls++) {
        dc_board_poll(&console->board);
        const bool idle = console->bench.from_servos_used == 0 && dc_board_idle_us(&console->board) > 0;
        if (idle || console->bench.now != instant)
            return;
    }
    fprintf(stderr, "the board never becomes idle\n");
    exit(1);
}

static void advance(struct console *console, uint64_t until)
{
    struct bench *bench = &console->bench;
    settle(console);
    while (bench->now < until) {
        const uint64_t idle = dc_board_idle_us(&console->board), left = until - bench->now;
        bench->now += idle < left ? idle : left;
        settle(console);
    }
}

static int digit(char c)
{
    static const char DIGITS[] = "0123456789abcdef";
    const char *found = c ? strchr(DIGITS, c) : NULL;
    return found ? (int)(found - DIGITS) : -1;
}

/* Return the number of bytes of the hexadecimal `text`; SIZE_MAX if it is invalid or longer than `room`. */
static size_t from_hex(const char *text, uint8_t *bytes, size_t room)
{
    size_t size = 0;
    for (; text[0] != '\0'; text += 2) {
        const int high = digit(text[0]), low = digit(text[1]);
        if (high < 0 || low < 0 || size == room)
            return SIZE_MAX;
        bytes[size++] = (uint8_t)(high * 16 + low);
    }
    return size;
}

static bool feed(struct console *console, const char *text)
{
    struct bench *bench = &console->bench;
    const size_t size = from_hex(text, bench->input, sizeof bench->input);
    if (size == SIZE_MAX)
        return false;
    bench->input_used = size;
    bench->input_read = 0;
    do {
        dc_board_poll(&console->board);
    } while (bench->input_read < bench->input_used);
    return true;
}

static bool set_pads(struct console *console, const char *text)
{
    uint8_t bytes[4 * DC_TAXELS];
    if (from_hex(text, bytes, sizeof bytes) != sizeof bytes)
        return false;
    for (size_t i = 0; i < DC_TAXELS; i++)
        console->bench.load[i] = dc_get_f32(bytes + 4 * i);
    return true;
}

static void press(struct bench *bench, float force)
{
    memset(bench->load, 0, sizeof bench->load);
    for (size_t pad = 0; pad < DC_TAXELS; pad += DC_PAD)
        for (size_t row = 4; row < 6; row++)
            for (size_t column = 4; column < 6; column++)
                bench->load[pad + row * DC_COLUMNS + column] = force / 4.0f;
}

static bool set_dead(struct bench *bench, const char *text)
{
    unsigned pad, row, column, dead;
    if (sscanf(text, "%u %u %u %u", &pad, &row, &column, &dead) != 4 || pad > 1 || row >= DC_ROWS ||
        column >= DC_COLUMNS)
        return false;
    bench->dead[pad * DC_PAD + row * DC_COLUMNS + column] = dead != 0;
    return true;
}

/* `current -2`, `output nan`, `feedback 1` or `target none` (measure again). */
static bool force(struct bench *bench, char *text)
{
    static const char *const NAMES[] = {"current", "target", "output", "battery", "feedback"};
    char *value = strchr(text, ' ');
    if (value == NULL)
        return false;
    *value++ = '\0';
    for (size_t i = 0; i < BENCH_READINGS; i++) {
        if (strcmp(text, NAMES[i]) == 0) {
            bench->is_forced[i] = strcmp(value, "none") != 0;
            bench->forced[i] = bench->is_forced[i] ? strtof(value, NULL) : NAN;
            return true;
        }
    }
    return false;
}

/* `50 0`, `nan 24`, `inf 0`: ohm and V that every probe finds, or `none` (measure again). */
static bool set_answer(struct bench *bench, const char *text)
{
    char *volt, *end;
    bench->answers = strcmp(text, "none") != 0;
    if (!bench->answers)
        return true;
    bench->ohm = strtof(text, &volt);
    bench->volt = strtof(volt, &end);
    return volt != text && end != volt && *end == '\0';
}

static void put_hex(FILE *answer, const uint8_t *bytes, size_t size)
{
    static const char DIGITS[] = "0123456789abcdef";
    for (size_t i = 0; i < size; i++) {
        putc(DIGITS[bytes[i] >> 4], answer);
        putc(DIGITS[bytes[i] & 15], answer);
    }
}

/* `bus HEX`: bytes from the servos; the answer is the bytes sent to them since. */
static bool tell_bus(struct bench *bench, const char *text, FILE *answer)
{
    const size_t room = BENCH_BUS - bench->from_servos_used;
    const size_t size = from_hex(text, bench->from_servos + bench->from_servos_used, room);
    if (size == SIZE_MAX)
        return false;
    bench->from_servos_used += size;
    fputs("bus ", answer);
    put_hex(answer, bench->to_servos, bench->to_servos_used);
    bench->to_servos_used = 0;
    putc('\n', answer);
    return true;
}

/* Settings that are plain numbers. */
static bool set_number(struct console *console, const char *name, double value)
{
    struct bench *bench = &console->bench;
    const struct { const char *name; float *number; } NUMBERS[] = {
        {"offset", &bench->offset}, {"noise", &bench->noise}, {"battery", &bench->battery},
        {"target", &bench->target}, {"resistance", &bench->resistance},
        {"stage_voltage", &console->config.stage_voltage}, {"input_fuse", &console->config.input_fuse},
    };
    const struct { const char *name; uint32_t *number; } WHOLE[] = {
        {"probe_time", &bench->probe_time}, {"scan_time", &bench->scan_time}, {"baud", &bench->baud},
        {"release_time", &bench->release_time}, {"poll_period", &console->config.poll_period},
        {"bus_takes", &bench->bus_takes},
    };
    const struct { const char *name; bool *set; } SWITCHES[] = {
        {"welded", &bench->welded}, {"stuck", &bench->stuck}, {"drop", &bench->dropped},
        {"steps_up", &console->config.steps_up},
    };
    for (size_t i = 0; i < sizeof NUMBERS / sizeof *NUMBERS; i++) {
        if (strcmp(name, NUMBERS[i].name) == 0) {
            *NUMBERS[i].number = (float)value;
            return true;
        }
    }
    for (size_t i = 0; i < sizeof WHOLE / sizeof *WHOLE; i++) {
        if (strcmp(name, WHOLE[i].name) == 0 && value >= 0.0 && value < 4294967296.0) {
            *WHOLE[i].number = (uint32_t)value;
            return true;
        }
    }
    for (size_t i = 0; i < sizeof SWITCHES / sizeof *SWITCHES; i++) {
        if (strcmp(name, SWITCHES[i].name) == 0) {
            *SWITCHES[i].set = value > 0.0;
            return true;
        }
    }
    return false;
}

/* A command with one number. */
static bool set_value(struct console *console, const char *name, const char *text)
{
    char *end;
    const double value = strtod(text, &end);
    if (end == text || *end != '\0')
        return false;
    if (set_number(console, name, value))
        return true;
    if (strcmp(name, "press") == 0) {
        press(&console->bench, (float)value);
        return true;
    }
    const uint8_t code = value >= 0.0 && value < 256.0 ? (uint8_t)value : 0u;
    if (strcmp(name, "detected") == 0)
        console->bench.detected = code;
    else if (strcmp(name, "trip") == 0)
        dc_contactor_trip(&console->board.contactor, code, console->board.clock.now);
    else if (strcmp(name, "servos") == 0 && console->stepped) /* of the next boot */
        console->hardware = bench_hardware(&console->bench, code != 0);
    else
        return false;
    return true;
}

static void tell_state(struct console *console, FILE *answer)
{
    const dc_board *board = &console->board;
    const dc_decoder_counters *decoder = &board->decoder.counters;
    struct bench *bench = &console->bench;
    fprintf(answer, "state commanded=%d fault=%d state=%d contactor=%d precharge=%d probe=%d refused=%d",
            board->contactor.closed, board->contactor.fault, (int)board->contactor.stage.state, bench_closed(bench),
            bench->outputs.precharge, bench->probing, decoder->refused_version);
    fprintf(answer, " coil=%d limit=%.9g voltage=%.9g current=%.9g broken=%.9g", bench->outputs.contactor,
            (double)bench->outputs.current_limit, (double)bench->outputs.voltage, (double)bench_current(bench),
            (double)bench->broken);
    fprintf(answer, " now=%" PRIu64 " switched_off=%" PRIu64, bench->now, bench->switched_off);
    const struct { const char *name; uint32_t count; } COUNTS[] = {
        {"packets", decoder->packets}, {"cobs", decoder->cobs_errors}, {"crc", decoder->crc_errors},
        {"length", decoder->length_errors}, {"version", decoder->version_errors},
        {"header", decoder->header_errors},
        {"unknown", board->counters.unknown_types}, {"missed", board->counters.missed_samples},
        {"dropped_tactile", board->counters.dropped_tactile}, {"dropped_power", board->counters.dropped_power},
        {"dropped_answers", board->counters.dropped_answers}, {"dropped_servo", board->counters.dropped_servo},
        {"servo_speed", bench->servo_speed},
    };
    for (size_t i = 0; i < sizeof COUNTS / sizeof *COUNTS; i++)
        fprintf(answer, " %s=%" PRIu32, COUNTS[i].name, COUNTS[i].count);
    putc('\n', answer);
}

/* Print the bytes sent since the last answer, and when the next poll is due. */
static void tell_sent(struct console *console, FILE *answer)
{
    struct bench *bench = &console->bench;
    fputs("sent ", answer);
    put_hex(answer, bench->output, bench->output_used);
    bench->output_used = 0;
    fprintf(answer, " idle %" PRIu32 "\n", dc_board_idle_us(&console->board));
}

/* Commands that advance time; false if `name` is none of them. */
static bool step(struct console *console, const char *name, const char *text, bool *good)
{
    const uint64_t instant = strtoull(text, NULL, 10);
    *good = true;
    if (strcmp(name, "advance") == 0) {
        advance(console, instant);
    } else if (strcmp(name, "jump") == 0) { /* without polls */
        console->bench.now = instant;
        settle(console);
    } else if (strcmp(name, "wire") == 0) {
        *good = feed(console, text);
    } else if (strcmp(name, "boot") == 0) {
        console->bench.now = instant;
        console_boot(console);
        settle(console);
    } else {
        return false;
    }
    return true;
}

void console_command(struct console *console, char *line, FILE *answer)
{
    line[strcspn(line, "\r\n")] = '\0';
    char *text = line + strcspn(line, " ");
    if (*text != '\0')
        *text++ = '\0';
    bool good = false;
    if (console->stepped && step(console, line, text, &good)) {
        if (good)
            tell_sent(console, answer);
    } else if (console->stepped && strcmp(line, "bus") == 0) {
        good = dc_servos_are_there(&console->hardware) && tell_bus(&console->bench, text, answer);
    } else if (strcmp(line, "state") == 0) {
        good = true;
        tell_state(console, answer);
    } else {
        if (strcmp(line, "boot") == 0) {
            good = true;
            console_boot(console);
        } else if (strcmp(line, "pads") == 0) {
            good = set_pads(console, text);
        } else if (strcmp(line, "dead") == 0) {
            good = set_dead(&console->bench, text);
        } else if (strcmp(line, "force") == 0) {
            good = force(&console->bench, text);
        } else if (strcmp(line, "probe") == 0) {
            good = set_answer(&console->bench, text);
        } else {
            good = set_value(console, line, text);
        }
        if (good)
            fputs("ok\n", answer);
    }
    if (!good)
        fprintf(answer, "error: unknown command: %.40s %.40s\n", line, text);
    fflush(answer);
}
