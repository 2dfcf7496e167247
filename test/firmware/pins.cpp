/* SPDX-License-Identifier: Apache-2.0 */
/* An Arduino core that writes down what the sketch asks of it: one command a line in, the calls that it causes and `done`
 * with its result out. test_sketch_calls.py compiles it with a form of the sketch. */
#include "Arduino.h"

#include <stdio.h>
#include <string.h>

#include "power_pins.h"
#include "servo_bus.h"

static uint32_t now, counts;
static int room = 127;

uint32_t micros(void) { return now; }
void delayMicroseconds(uint32_t) {}
void pinMode(uint32_t pin, uint32_t mode) { printf("mode %u %u\n", (unsigned)pin, (unsigned)mode); }
void digitalWrite(uint32_t pin, uint32_t value) { printf("pin %u %u\n", (unsigned)pin, (unsigned)value); }
int digitalRead(uint32_t) { return LOW; }
void analogReadResolution(int) {}
uint32_t analogRead(uint32_t) { return counts; }
void analogWrite(uint32_t pin, uint32_t value) { printf("pwm %u %u\n", (unsigned)pin, (unsigned)value); }
uint32_t CDC_Itf_TxAvailable(void) { return 0; }
void drv_dxl_begin(uint8_t) { puts("driver"); }
void drv_dxl_tx_enable(uint8_t, uint8_t enable) { puts(enable ? "speak" : "listen"); }

UARTClass Serial1, Serial3;
USBSerial Serial;

static const char *name_of(const UARTClass *port) { return port == &Serial1 ? "bus" : "link"; }
void UARTClass::setDxlMode(bool dxl) { printf("%s connector %d\n", name_of(this), dxl); }
void UARTClass::begin(uint32_t speed) { printf("%s begin %u\n", name_of(this), (unsigned)speed); }
int UARTClass::read(void) { return -1; }
int UARTClass::availableForWrite(void) { return room; }
void UARTClass::flush(void) { printf("%s flush\n", name_of(this)); }
size_t UARTClass::write(const uint8_t *, size_t size)
{
  printf("%s write %u\n", name_of(this), (unsigned)size);
  return size;
}

void USBSerial::begin(uint32_t) {}
int USBSerial::available(void) { return 0; }
int USBSerial::read(void) { return -1; }
size_t USBSerial::write(const uint8_t *, size_t) { return 0; }
USBSerial::operator bool() { return false; }

static RCC_TypeDef rcc;
static PWR_TypeDef pwr;
static BKP_TypeDef bkp;
static IWDG_TypeDef iwdg;
RCC_TypeDef *const RCC = &rcc;
PWR_TypeDef *const PWR = &pwr;
BKP_TypeDef *const BKP = &bkp;
IWDG_TypeDef *const IWDG = &iwdg;

static int carry_out(const char *name, unsigned a, unsigned b, unsigned c)
{
  static const uint8_t bytes[256] = {0};
  float ohm, volt;
  if (strcmp(name, "setup") == 0) {
    setup();
  } else if (strcmp(name, "loop") == 0) {
    loop();
  } else if (strcmp(name, "now") == 0) {
    now = a;
  } else if (strcmp(name, "counts") == 0) {
    counts = a;
  } else if (strcmp(name, "room") == 0) {
    room = (int)a;
  } else if (strcmp(name, "watchdog") == 0) { /* asked for by the bootloader, as the core does */
    IWDG->RLR = a;
    IWDG->KR = 0;
  } else if (strcmp(name, "fed") == 0) {
    return IWDG->KR == 0xAAAA;
  } else if (strcmp(name, "drive") == 0) {
    const dc_power_outputs outputs = {a != 0, b != 0, (float)c};
    power_drive(NULL, &outputs);
  } else if (strcmp(name, "probe") == 0) {
    probe_start(NULL);
  } else if (strcmp(name, "probed") == 0) {
    return probe_poll(NULL, &ohm, &volt);
  } else if (strcmp(name, "speed") == 0) {
    return servos_speed(NULL, a);
  } else if (strcmp(name, "send") == 0) {
    return (int)servos_write(NULL, bytes, a);
  } else {
    return -1;
  }
  return 0;
}

int main(void)
{
  char line[80], name[20];
  while (fgets(line, sizeof line, stdin) != NULL) {
    unsigned a = 0, b = 0, c = 0;
    if (sscanf(line, "%19s %u %u %u", name, &a, &b, &c) < 1)
      return 2;
    printf("done %d\n", carry_out(name, a, b, c));
    fflush(stdout);
  }
  return 0;
}
