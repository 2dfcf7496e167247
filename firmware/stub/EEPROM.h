/* SPDX-License-Identifier: Apache-2.0 */
/* Declares the part of the core's EEPROM library that the sketch uses. */
#ifndef EEPROM_STUB_H
#define EEPROM_STUB_H

#include <stdint.h>

struct EEPROMClass {
  uint8_t cell;
  uint8_t read(int) { return cell; }
  void write(int, uint8_t value) { cell = value; }
};
static EEPROMClass EEPROM;

#endif
