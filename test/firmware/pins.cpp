/* SPDX-License-Identifier: Apache-2.0 */
/* An Arduino core that writes down what the sketch asks of it: one command a line in, the calls that it causes and `done`
 * with its result out. test_sketch_calls.py compiles it with a form of the sketch. The analog inputs of electrodes and
 * probe see a port: the probe's 5 V through 100 ohm, and what lies at the electrodes. */
#include "Arduino.h"

#include <math.h>

#include <stdio.h>
#include <string.h>

#include "power_pins.h"
#include "servo_bus.h"
#include "board_wiring.h"

static uint32_t now;
static int room = 127;

static const float SOURCE_VOLTAGE = 5.0f, SOURCE_RESISTANCE = 100.0f;
static struct {
  float battery, resistance, capacitance; /* V, ohm, F; a battery of NAN is none */
  bool diode;                             /* no current out of the port */
  uint32_t connects;                      /* us, when it touches */
} port = {NAN, INFINITY, 0.0f, false, 0};
static bool driven;  /* by the probe */
static float stored; /* V of the port's capacitor */
static uint32_t charged; /* us, until when `stored` is computed */

static void settle()
{
  if (driven && port.capacitance > 0.0f)
    stored = SOURCE_VOLTAGE + (stored - SOURCE_VOLTAGE) *
             expf(-(float)(now - charged) * 1e-6f / (SOURCE_RESISTANCE * port.capacitance));
  charged = now;
}

/* V of what lies behind the port's resistance; NAN = nothing that drives or keeps a voltage. */
static float behind()
{
  if (now < port.connects)
    return NAN;
  return port.capacitance > 0.0f ? stored : port.battery;
}

/* A out of the probe. */
static float probe_current()
{
  settle();
  if (!driven || now < port.connects)
    return 0.0f;
  const float inner = port.capacitance > 0.0f ? 0.0f : port.resistance;
  const float voltage = isnan(behind()) ? 0.0f : behind();
  const float current = (SOURCE_VOLTAGE - voltage) / (SOURCE_RESISTANCE + inner);
  return port.diode && current < 0.0f ? 0.0f : current;
}

/* V at the electrodes. */
static float electrodes()
{
  const float current = probe_current();
  if (driven)
    return SOURCE_VOLTAGE - current * SOURCE_RESISTANCE;
  return isnan(behind()) || port.diode ? 0.0f : behind();
}

static uint32_t counts_of(const AnalogInput &input, float value)
{
  const float counts = roundf(value / input.scale + input.zero);
  return counts < 0.0f ? 0u : counts > 4095.0f ? 4095u : (uint32_t)counts;
}

uint32_t micros(void) { return now; }
void delayMicroseconds(uint32_t) {}
void pinMode(uint32_t pin, uint32_t mode) { printf("mode %u %u\n", (unsigned)pin, (unsigned)mode); }
void digitalWrite(uint32_t pin, uint32_t value)
{
  printf("pin %u %u\n", (unsigned)pin, (unsigned)value);
  settle();
  if (pin == PIN_PROBE)
    driven = value == HIGH;
}
int digitalRead(uint32_t) { return LOW; }
void analogReadResolution(int) {}
uint32_t analogRead(uint32_t pin)
{
  if (pin == TARGET.pin)
    return counts_of(TARGET, electrodes());
  if (pin == PROBE_VOLTAGE.pin)
    return counts_of(PROBE_VOLTAGE, electrodes());
  return pin == PROBE_CURRENT.pin ? counts_of(PROBE_CURRENT, probe_current()) : 0;
}
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

/* `port live|diode|capacitor|resistor VALUE US`: V, V, F or ohm, connected at US. */
static bool set_port(const char *kind, float value, unsigned connects)
{
  port = {NAN, INFINITY, 0.0f, strcmp(kind, "diode") == 0, connects};
  stored = 0.0f;
  if (strcmp(kind, "capacitor") == 0)
    port.capacitance = value;
  else if (strcmp(kind, "resistor") == 0)
    port.resistance = value;
  else if (strcmp(kind, "live") == 0 || port.diode)
    port.battery = value, port.resistance = 0.15f;
  else
    return false;
  return true;
}

static int carry_out(const char *name, unsigned a, unsigned b, unsigned c)
{
  static const uint8_t bytes[256] = {0};
  static float ohm, volt;
  if (strcmp(name, "setup") == 0) {
    setup();
  } else if (strcmp(name, "loop") == 0) {
    loop();
  } else if (strcmp(name, "now") == 0) {
    now = a;
  } else if (strcmp(name, "room") == 0) {
    room = (int)a;
  } else if (strcmp(name, "watchdog") == 0) { /* asked for by the bootloader, as the core does */
    IWDG->RLR = a;
    IWDG->KR = 0;
  } else if (strcmp(name, "fed") == 0) {
    return IWDG->KR == 0xAAAA;
  } else if (strcmp(name, "drive") == 0) {
    const dc_power_outputs outputs = {a != 0, b != 0, (float)c, (float)c};
    power_drive(NULL, &outputs);
  } else if (strcmp(name, "probe") == 0) {
    probe_start(NULL);
  } else if (strcmp(name, "probed") == 0) {
    const bool ended = probe_poll(NULL, &ohm, &volt);
    if (ended)
      printf("found %.9g %.9g\n", (double)ohm, (double)volt);
    return ended;
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
    char kind[20];
    float value;
    if (sscanf(line, "port %19s %f %u", kind, &value, &a) == 3) {
      printf("done %d\n", set_port(kind, value, a) ? 0 : -1);
      fflush(stdout);
      continue;
    }
    if (sscanf(line, "%19s %u %u %u", name, &a, &b, &c) < 1)
      return 2;
    printf("done %d\n", carry_out(name, a, b, c));
    fflush(stdout);
  }
  return 0;
}
