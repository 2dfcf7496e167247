/* SPDX-License-Identifier: Apache-2.0 */
/* The board in real time behind a pseudo-terminal. */
#ifndef TERMINAL_H
#define TERMINAL_H

#include "console.h"

/* Serve until standard input ends or says `quit`; print `ready PATH` first. `link`: a symbolic link to make, or NULL.
 * Return the exit status. */
int terminal_serve(uint64_t seed, const char *link);

#endif
