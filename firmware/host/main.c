/* SPDX-License-Identifier: Apache-2.0 */
/* The board's C core on a simulated bench: see docs/firmware.md. */
#include <stdlib.h>
#include <string.h>

#include "console.h"
#include "terminal.h"

static const char USAGE[] =
    "usage: board_host [--seed N] --step [US]\n"
    "       board_host [--seed N] [--servos PORT] --pty [LINK]\n"
    "  --step    time advances only by commands on standard input, from US (default 0)\n"
    "  --pty     serve in real time on a pseudo-terminal; LINK is a symbolic link to it\n"
    "  --servos  connect the servos on this serial port to the board\n";

static struct console console;
static char line[200000]; /* `wire` with 64 KiB */

static int step(uint64_t now, uint64_t seed)
{
    console_init(&console, now, seed, true, false);
    while (fgets(line, sizeof line, stdin) != NULL && strcmp(line, "quit\n") != 0)
        console_command(&console, line, stdout);
    return 0;
}

int main(int count, char **arguments)
{
    uint64_t seed = 1;
    int at = 1;
    if (at + 1 < count && strcmp(arguments[at], "--seed") == 0) {
        seed = strtoull(arguments[at + 1], NULL, 10);
        at += 2;
    }
    const char *servos = NULL;
    if (at + 1 < count && strcmp(arguments[at], "--servos") == 0) {
        servos = arguments[at + 1];
        at += 2;
    }
    const char *mode = at < count ? arguments[at++] : "";
    const char *value = at < count ? arguments[at++] : NULL;
    if (at == count && servos == NULL && strcmp(mode, "--step") == 0)
        return step(value ? strtoull(value, NULL, 10) : 0, seed);
    if (at == count && strcmp(mode, "--pty") == 0)
        return terminal_serve(seed, servos, value);
    fputs(USAGE, stderr);
    return 2;
}
