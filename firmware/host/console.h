/* SPDX-License-Identifier: Apache-2.0 */
/* A board on a bench, controlled by lines of text:

   press N, pads HEX: N on four taxels in the middle of each pad; 200 little-endian f32
   offset N, noise N, dead PAD ROW COLUMN 0|1: resting value, standard deviation, dead taxel
   battery V, target V, resistance OHM: charge circuit; inf = not touching. A target of 1 V or more is live
   detected F, trip F: the stage's detectors report F from now on; the board trips once
   welded 1, stuck 1, drop 1: contacts do not open; do not close; coil without supply, briefly: a bounce
   force current|target|output|battery|feedback X|none: measure X, also nan; measure normally again
   probe OHM V|none: what every probe finds, also nan and inf; measure normally again
   probe_time US, scan_time US, release_time US: duration of a probe, a sampling, the contacts' opening
   baud B: the wire; 0 takes everything, 1 nothing
   poll_period US, steps_up 0|1, stage_voltage V, input_fuse A: for the next boot
   servos 0|1: servo bus at the next boot (--step only)
   bus HEX, bus_takes N (--step only): bytes from the servos, returns those sent to them; what the bus takes at once
   boot, state, quit: reboot, which keeps a weld; print commands, outputs, counters; end */
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
