/* SPDX-License-Identifier: Apache-2.0 */
/* Both tactile arrays on the pins of board_wiring.h. */
#ifndef TAXEL_SCAN_H
#define TAXEL_SCAN_H

#include <dc_payload.h>

void taxels_begin();

/* Hook of dc_hardware: N, left then right, NaN = dead. */
void taxels_read(void *context, float forces[DC_TAXELS]);

#endif
