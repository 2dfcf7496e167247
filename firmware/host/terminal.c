/* SPDX-License-Identifier: Apache-2.0 */
#define _XOPEN_SOURCE 700

#include "terminal.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define LONGEST_WAIT 500 /* ms */

struct terminal {
    struct console console;
    int host;  /* our end */
    int board; /* the host's end; kept open, so that the terminal does not hang up between two hosts */
    int servos; /* the port of the servos' bus, -1 = none */
    size_t line_used;
    char line[4096];
};

static struct terminal terminal; /* 4 MB are too much for the stack */

static uint64_t monotonic_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

static uint32_t now_us(void *context)
{
    ((struct bench *)context)->now = monotonic_us();
    return (uint32_t)(((struct bench *)context)->now & 0xFFFFFFFFu);
}

static size_t read_terminal(void *context, uint8_t *bytes, size_t size)
{
    (void)context;
    const ssize_t count = read(terminal.host, bytes, size);
    return count > 0 ? (size_t)count : 0;
}

/* Discard bytes that the host did not read, as a full receive buffer does. */
static size_t write_terminal(void *context, const uint8_t *bytes, size_t size)
{
    (void)context;
    ssize_t count = write(terminal.host, bytes, size);
    if (count < 0 && errno == EAGAIN) {
        tcflush(terminal.board, TCIFLUSH);
        count = write(terminal.host, bytes, size);
    }
    return count > 0 ? (size_t)count : 0;
}

static size_t read_servos(void *context, uint8_t *bytes, size_t size)
{
    (void)context;
    const ssize_t count = read(terminal.servos, bytes, size);
    return count > 0 ? (size_t)count : 0;
}

static size_t write_servos(void *context, const uint8_t *bytes, size_t size)
{
    (void)context;
    const ssize_t count = write(terminal.servos, bytes, size);
    return count > 0 ? (size_t)count : 0;
}

static bool set_servo_speed(void *context, uint32_t speed)
{
    static const struct { uint32_t speed; speed_t code; } SPEEDS[] = {
        {9600, B9600}, {57600, B57600}, {115200, B115200}, {1000000, B1000000}, {2000000, B2000000},
        {3000000, B3000000}, {4000000, B4000000},
    };
    (void)context;
    struct termios settings;
    for (size_t i = 0; i < sizeof SPEEDS / sizeof *SPEEDS; i++)
        if (SPEEDS[i].speed == speed)
            return tcgetattr(terminal.servos, &settings) == 0 && cfsetispeed(&settings, SPEEDS[i].code) == 0 &&
                   cfsetospeed(&settings, SPEEDS[i].code) == 0 &&
                   tcsetattr(terminal.servos, TCSANOW, &settings) == 0 && tcflush(terminal.servos, TCIFLUSH) == 0;
    return false;
}

static bool make_raw(int descriptor)
{
    struct termios settings;
    if (tcgetattr(descriptor, &settings) != 0)
        return false;
    settings.c_iflag = 0;
    settings.c_oflag = 0;
    settings.c_lflag = 0;
    settings.c_cflag = CS8 | CREAD | CLOCAL;
    settings.c_cc[VMIN] = 1;
    settings.c_cc[VTIME] = 0;
    return tcsetattr(descriptor, TCSANOW, &settings) == 0;
}

static const char *open_terminal(void)
{
    terminal.host = posix_openpt(O_RDWR | O_NOCTTY);
    if (terminal.host < 0 || grantpt(terminal.host) != 0 || unlockpt(terminal.host) != 0)
        return NULL;
    const char *path = ptsname(terminal.host);
    terminal.board = path ? open(path, O_RDWR | O_NOCTTY) : -1;
    if (terminal.board < 0 || !make_raw(terminal.board) || fcntl(terminal.host, F_SETFL, O_NONBLOCK) != 0)
        return NULL;
    return path;
}

/* Execute the received lines; false at end of input. */
static bool obey_input(void)
{
    const size_t room = sizeof terminal.line - 1 - terminal.line_used;
    const ssize_t count = read(STDIN_FILENO, terminal.line + terminal.line_used, room);
    if (count <= 0)
        return false;
    terminal.line_used += (size_t)count;
    for (;;) {
        terminal.line[terminal.line_used] = '\0';
        char *end = strchr(terminal.line, '\n');
        if (end == NULL) {
            if (terminal.line_used == sizeof terminal.line - 1)
                terminal.line_used = 0; /* no command is so long */
            return true;
        }
        *end = '\0';
        if (strcmp(terminal.line, "quit") == 0)
            return false;
        const size_t length = (size_t)(end + 1 - terminal.line);
        console_command(&terminal.console, terminal.line, stdout);
        terminal.line_used -= length;
        memmove(terminal.line, terminal.line + length, terminal.line_used);
    }
}

int terminal_serve(uint64_t seed, const char *servos, const char *link)
{
    struct console *console = &terminal.console;
    const char *path = open_terminal();
    if (path == NULL) {
        fprintf(stderr, "no pseudo-terminal: %s\n", strerror(errno));
        return 1;
    }
    if (link != NULL && ((unlink(link) != 0 && errno != ENOENT) || symlink(path, link) != 0)) {
        fprintf(stderr, "%s: %s\n", link, strerror(errno));
        return 1;
    }
    terminal.servos = servos ? open(servos, O_RDWR | O_NOCTTY | O_NONBLOCK) : -1;
    if (servos != NULL && (terminal.servos < 0 || !make_raw(terminal.servos))) {
        fprintf(stderr, "%s: %s\n", servos, strerror(errno));
        return 1;
    }
    console_init(console, monotonic_us(), seed, false, false);
    if (servos != NULL) {
        console->hardware.servo_read = read_servos;
        console->hardware.servo_write = write_servos;
        console->hardware.servo_speed = set_servo_speed;
    }
    console->hardware.now_us = now_us;
    console->hardware.read = read_terminal;
    console->hardware.write = write_terminal;
    console_boot(console);
    printf("ready %s\n", link ? link : path);
    fflush(stdout);
    struct pollfd ends[3] = {
        {.fd = terminal.host, .events = POLLIN}, {.fd = STDIN_FILENO, .events = POLLIN},
        {.fd = terminal.servos, .events = POLLIN}, /* -1 is ignored by poll */
    };
    for (;;) {
        dc_board_poll(&console->board);
        const uint32_t idle = (dc_board_idle_us(&console->board) + 999u) / 1000u;
        if (poll(ends, 3, idle < LONGEST_WAIT ? (int)idle : LONGEST_WAIT) < 0 && errno != EINTR)
            break;
        if (ends[1].revents != 0 && !obey_input())
            break;
        if ((ends[2].revents & (POLLHUP | POLLERR | POLLNVAL)) != 0)
            ends[2].fd = -1; /* the servo port has vanished: the servos stay silent */
    }
    if (link != NULL)
        unlink(link);
    return 0;
}
