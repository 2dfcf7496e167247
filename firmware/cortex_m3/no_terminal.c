/* SPDX-License-Identifier: Apache-2.0 */
/* In place of terminal.c where there is no operating system: as code of the board's processor, on an emulator. */
#include "terminal.h"

int terminal_serve(uint64_t seed, const char *servos, const char *link)
{
    (void)seed;
    (void)servos;
    (void)link;
    fputs("this program has no pseudo-terminals\n", stderr);
    return 1;
}
