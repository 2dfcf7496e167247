/* SPDX-License-Identifier: Apache-2.0 */
#include "power_pins.h"

#include <Arduino.h>
#include <dc_packet.h>

#include "board_wiring.h"

static uint32_t probe_began;
static bool probing;

static bool wired(uint8_t pin)
{
  return pin != UNWIRED;
}

static float value_of(const AnalogInput &input)
{
  if (!wired(input.pin))
    return NAN;
  return ((float)analogRead(input.pin) - input.zero) * input.scale;
}

static void switch_pin(uint8_t pin, bool on)
{
  if (wired(pin))
    digitalWrite(pin, on ? HIGH : LOW);
}

static void begin_output(uint8_t pin)
{
  if (!wired(pin))
    return;
  digitalWrite(pin, LOW); /* before it becomes an output */
  pinMode(pin, OUTPUT);
  digitalWrite(pin, LOW);
}

void power_begin()
{
  begin_output(PIN_CONTACTOR);
  begin_output(PIN_PRECHARGE);
  begin_output(PIN_PROBE);
  if (wired(PIN_LIMIT))
    analogWrite(PIN_LIMIT, 0);
  if (wired(PIN_FEEDBACK))
    pinMode(PIN_FEEDBACK, INPUT);
  if (wired(PIN_OVERCURRENT))
    pinMode(PIN_OVERCURRENT, INPUT);
}

void power_read(void *, dc_power_reading *reading)
{
  reading->battery = value_of(BATTERY);
  reading->target = value_of(TARGET);
  reading->output = value_of(OUTPUT_SIDE);
  reading->current = value_of(CURRENT);
  reading->contactor_closed = wired(PIN_FEEDBACK) && digitalRead(PIN_FEEDBACK) == HIGH;
  const bool tripped = wired(PIN_OVERCURRENT) && digitalRead(PIN_OVERCURRENT) == HIGH;
  reading->fault = tripped ? DC_OVER_CURRENT : DC_NO_FAULT;
}

void power_drive(void *, const dc_power_outputs *outputs)
{
  /* Off first, on last: the pins must never pass through a state that was not commanded. */
  if (!outputs->contactor)
    switch_pin(PIN_CONTACTOR, false);
  if (!outputs->precharge)
    switch_pin(PIN_PRECHARGE, false);
  if (wired(PIN_LIMIT)) {
    const float share = outputs->current_limit / LIMIT_FULL_SCALE; /* NaN, and then 0, while the scale is unknown */
    analogWrite(PIN_LIMIT, share > 0.0f ? (uint32_t)(255.0f * (share < 1.0f ? share : 1.0f)) : 0);
  }
  if (outputs->precharge)
    switch_pin(PIN_PRECHARGE, true);
  if (outputs->contactor)
    switch_pin(PIN_CONTACTOR, true);
}

void probe_start(void *)
{
  switch_pin(PIN_PROBE, true);
  probe_began = micros();
  probing = true;
}

bool probe_poll(void *, float *resistance, float *target)
{
  /* Signed, because micros() can step back by a millisecond, which must not end a wait that has just begun. */
  if (!probing || (int32_t)(micros() - probe_began) < (int32_t)PROBE_SETTLE_US)
    return false;
  const float current = value_of(PROBE_CURRENT);
  const float voltage = value_of(PROBE_VOLTAGE);
  switch_pin(PIN_PROBE, false);
  *target = value_of(TARGET);
  *resistance = current < PROBE_OPEN_CURRENT ? INFINITY : voltage / current; /* NaN if one is unknown */
  probing = false;
  return true;
}

void probe_stop(void *)
{
  switch_pin(PIN_PROBE, false);
  probing = false;
}
