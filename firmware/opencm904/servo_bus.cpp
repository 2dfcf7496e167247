/* SPDX-License-Identifier: Apache-2.0 */
#include "servo_bus.h"

#include <Arduino.h>

#include "board_wiring.h"

#if SERVOS_ON_BOARD

static const uint32_t LONGEST_SENDING_US = 500; /* the host can send 50 bytes in this time, and a poll reads 64 */
static const size_t UART_ROOM = 100;            /* bytes; the core's buffer holds 127 */
static size_t longest = UART_ROOM;

void servos_begin()
{
  SERVO_UART.setDxlMode(true); /* the connector's pins, from the next begin on */
  drv_dxl_begin(SERVO_CHANNEL);
  drv_dxl_tx_enable(SERVO_CHANNEL, FALSE);
}

bool servos_speed(void *, uint32_t speed)
{
  if (speed < 9600 || speed > 4500000)
    return false;
  const size_t bytes = speed / 10 * LONGEST_SENDING_US / 1000000;
  longest = bytes < 1 ? 1 : bytes < UART_ROOM ? bytes : UART_ROOM;
  SERVO_UART.begin(speed); /* discards received bytes */
  return true;
}

size_t servos_read(void *, uint8_t *bytes, size_t size)
{
  size_t count = 0;
  for (int next; count < size && (next = SERVO_UART.read()) >= 0;)
    bytes[count++] = (uint8_t)next;
  return count;
}

/* A servo answers some microseconds after the last bit, so the line must be released at once: flush waits until the
 * transmitter is empty. A longer packet is sent in pieces, with pauses between them. */
size_t servos_write(void *, const uint8_t *bytes, size_t size)
{
  const size_t count = size < longest ? size : longest;
  drv_dxl_tx_enable(SERVO_CHANNEL, TRUE);
  SERVO_UART.write(bytes, count);
  SERVO_UART.flush();
  drv_dxl_tx_enable(SERVO_CHANNEL, FALSE);
  return count;
}

#endif
