/* SPDX-License-Identifier: Apache-2.0 */
/* Start vectors of an emulated Cortex-M3. A fault has no handler and ends the emulator with a message. */
#include <stdint.h>

#define END_OF_MEMORY 0x22000000u

extern void _start(void); /* the C library's */

struct vectors {
    uintptr_t stack;
    void (*reset)(void);
    void (*others[14])(void);
};

__attribute__((section(".vectors"), used)) static const struct vectors VECTORS = {END_OF_MEMORY, _start, {0}};
