/* SPDX-License-Identifier: Apache-2.0 */
/* The board's end of the board link on a ROBOTIS OpenCM 9.04 (STM32F103CB).
 *
 * NOT RUN ON HARDWARE: only linked with the core of the board package 1.5.1. Fill in board_wiring.h, then
 * follow "First start" of docs/firmware.md before anything carries current. */
#include <EEPROM.h>
#include <dc_board.h>
#include <dc_crc32.h>

#include "power_pins.h"
#include "servo_bus.h"
#include "taxel_scan.h"
#include "board_wiring.h"

static dc_board board;

static uint32_t now_us(void *)
{
  return micros();
}

#if LINK_OVER_USB
static size_t link_read(void *, uint8_t *bytes, size_t size)
{
  size_t count = 0;
  while (count < size && Serial.available() > 0)
    bytes[count++] = (uint8_t)Serial.read();
  return count;
}

/* Serial.write waits up to 100 ms for room, so it is never given more than fits. Bytes for a port that no host has
 * opened are discarded, so that the next host does not receive stale ones. */
static size_t link_write(void *, const uint8_t *bytes, size_t size)
{
  if (!Serial)
    return size;
  const size_t room = CDC_Itf_TxAvailable();
  const size_t count = size < room ? size : room > 0 ? room - 1 : 0;
  return count > 0 ? Serial.write(bytes, count) : 0;
}
#else
static size_t link_read(void *, uint8_t *bytes, size_t size)
{
  size_t count = 0;
  for (int next; count < size && (next = LINK_UART.read()) >= 0;)
    bytes[count++] = (uint8_t)next;
  return count;
}

/* LINK_UART.write waits if its buffer is full, so it is never given more than fits. */
static size_t link_write(void *, const uint8_t *bytes, size_t size)
{
  const int room = LINK_UART.availableForWrite();
  const size_t count = room <= 0 ? 0 : size < (size_t)room ? size : (size_t)room;
  return count > 0 ? LINK_UART.write(bytes, count) : 0;
}
#endif

/* The core's EEPROM is a page of flash: a write takes 0.1 ms, and every 250th erases a page, 40 ms. */
static uint8_t byte_load(void *)
{
  return EEPROM.read(0);
}

static void byte_save(void *, uint8_t value)
{
  EEPROM.write(0, value);
}

static const dc_hardware HARDWARE = {
    NULL,         now_us,      link_read,  link_write, taxels_read,
    power_read,   power_drive, probe_start, probe_poll, probe_stop,
    byte_load,    byte_save,
#if SERVOS_ON_BOARD
    servos_read,  servos_write, servos_speed,
#else
    NULL,         NULL,        NULL,
#endif
};

static const dc_config CONFIG = {CURRENT_LIMIT, LOWEST_TARGET, HIGHEST_TARGET,
                                 LOWEST_BATTERY, HIGHEST_BATTERY, POLL_PERIOD_US,
                                 STAGE_STEPS_UP, STAGE_VOLTAGE, INPUT_FUSE};

/* A number that differs at each boot: a counter that survives a reset, and, for a lost supply, the noise of the analog
 * inputs. */
static uint32_t new_boot_id()
{
  RCC->APB1ENR |= RCC_APB1ENR_PWREN | RCC_APB1ENR_BKPEN;
  PWR->CR |= PWR_CR_DBP;
  BKP->DR1 = (uint16_t)(BKP->DR1 + 1);
  uint32_t id = BKP->DR1;
  for (uint8_t round = 0; round < 32; round++) {
    for (uint8_t pin = 0; pin < 10; pin++) {
      const uint32_t counts = analogRead(pin);
      id = dc_crc32(id, (const uint8_t *)&counts, sizeof counts);
    }
  }
  return id;
}

static void start_watchdog()
{
  IWDG->KR = 0x5555;
  IWDG->PR = 3; /* 40 kHz / 32 */
  IWDG->RLR = WATCHDOG_COUNTS;
  IWDG->KR = 0xCCCC;
}

/* To start its bootloader, the core sets this watchdog to 10 ms and waits for it: do not reload it then. */
static void feed_watchdog()
{
  if (IWDG->RLR == WATCHDOG_COUNTS)
    IWDG->KR = 0xAAAA;
}

void setup()
{
  power_begin(); /* off before anything else */
  taxels_begin();
#if SERVOS_ON_BOARD
  servos_begin();
#endif
#if LINK_OVER_USB
  Serial.begin(LINK_BAUD);
#else
  LINK_UART.begin(LINK_BAUD);
#endif
  dc_board_boot(&board, &HARDWARE, &CONFIG, new_boot_id());
  start_watchdog();
}

void loop()
{
  dc_board_poll(&board);
  feed_watchdog();
}
