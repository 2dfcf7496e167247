/* SPDX-License-Identifier: Apache-2.0 */
#include "taxel_scan.h"

#include <Arduino.h>

#include "board_wiring.h"

static bool wired()
{
  for (uint8_t bit = 0; bit < 4; bit++) {
    if (PIN_ROW[bit] == UNWIRED || PIN_COLUMN[bit] == UNWIRED)
      return false;
  }
  return true;
}

static void select(const uint8_t pins[4], uint8_t address)
{
  for (uint8_t bit = 0; bit < 4; bit++)
    digitalWrite(pins[bit], (address >> bit) & 1 ? HIGH : LOW);
}

static float force_of(uint8_t pin)
{
  if (pin == UNWIRED)
    return NAN;
  const uint32_t counts = analogRead(pin);
  if (counts < TAXEL_LOWEST || counts > TAXEL_HIGHEST)
    return NAN;
  return ((float)counts - TAXEL_ZERO) * TAXEL_SCALE;
}

void taxels_begin()
{
  analogReadResolution(12);
  if (!wired())
    return;
  for (uint8_t bit = 0; bit < 4; bit++) {
    pinMode(PIN_ROW[bit], OUTPUT);
    pinMode(PIN_COLUMN[bit], OUTPUT);
  }
}

void taxels_read(void *, float forces[DC_TAXELS])
{
  const bool connected = wired();
  for (uint8_t row = 0; row < DC_ROWS; row++) {
    if (connected)
      select(PIN_ROW, row);
    for (uint8_t column = 0; column < DC_COLUMNS; column++) {
      const uint32_t taxel = row * DC_COLUMNS + column;
      if (connected) {
        select(PIN_COLUMN, column);
        delayMicroseconds(TAXEL_SETTLE_US);
      }
      forces[taxel] = connected ? force_of(PIN_PAD_LEFT) : NAN;
      forces[DC_PAD + taxel] = connected ? force_of(PIN_PAD_RIGHT) : NAN;
    }
  }
}
