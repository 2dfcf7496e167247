/* SPDX-License-Identifier: Apache-2.0 */
/* A board on a bench, controlled by lines of text; docs/firmware.md lists the commands. */
#ifndef CONSOLE_H
#define CONSOLE_H

#include <stdio.h>

#include "bench.h"

struct console {
    struct bench bench;
    dc_board board;
    dc_hardware hardware;
    dc_config config; /* of the next boot */
    bool stepped;     /* time advances by command only */
};

/* Boot a board, with or without a servos' bus. `seed` determines noise and boot ids; `now` is us. */
void console_init(struct console *console, uint64_t now, uint64_t seed, bool stepped, bool servos);

void console_boot(struct console *console);

/* Execute one line (it is modified) and write one line of answer. */
void console_command(struct console *console, char *line, FILE *answer);

#endif
