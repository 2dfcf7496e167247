/* SPDX-License-Identifier: Apache-2.0 */
/* Replaces terminal.c without an operating system: on the emulated processor of the board. */
#include "terminal.h"

int terminal_serve(uint64_t seed, const char *servos, const char *link)
{
    (void)seed;
    (void)servos;
    (void)link;
    fputs("this program has no pseudo-terminals\n", stderr);
    return 1;
}
