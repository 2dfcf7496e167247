/* SPDX-License-Identifier: Apache-2.0 */
/* The board in real time behind a pseudo-terminal. */
#ifndef TERMINAL_H
#define TERMINAL_H

#include "console.h"

/* Serve until standard input ends or says `quit`; print `ready PATH` first. `servos`: the port of the servos' bus that
 * hangs on the board, or NULL; `link`: a symbolic link to make, or NULL. Return the exit status. */
int terminal_serve(uint64_t seed, const char *servos, const char *link);

#endif
