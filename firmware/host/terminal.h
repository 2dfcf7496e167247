/* SPDX-License-Identifier: Apache-2.0 */
/* The board in real time behind a pseudo-terminal. */
#ifndef TERMINAL_H
#define TERMINAL_H

#include "console.h"

/* Serve until end of input or `quit`; print `ready PATH` first. `servos`: serial port of the servos' bus to connect to
 * the board, or NULL; `link`: a symbolic link to create, or NULL. Return the exit status. */
int terminal_serve(uint64_t seed, const char *servos, const char *link);

#endif
