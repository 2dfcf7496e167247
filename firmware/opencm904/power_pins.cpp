/* SPDX-License-Identifier: Apache-2.0 */
#include "power_pins.h"

#include <Arduino.h>
#include <dc_contactor.h>
#include <dc_packet.h>

#include "board_wiring.h"

static const float PROBE_SOURCE = 5.5f; /* V; more cannot come from the probe */

static uint32_t probe_began; /* us, the present look */
static bool probing, driving;

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

/* Write a PWM; 0 for a NaN, while the scale is unknown. */
static void write_share(uint8_t pin, float share)
{
  if (wired(pin))
    analogWrite(pin, share > 0.0f ? (uint32_t)(255.0f * (share < 1.0f ? share : 1.0f)) : 0);
}

void power_begin()
{
  begin_output(PIN_CONTACTOR);
  begin_output(PIN_PRECHARGE);
  begin_output(PIN_PROBE);
  write_share(PIN_LIMIT, 0.0f);
  write_share(PIN_VOLTAGE, 0.0f);
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
  write_share(PIN_LIMIT, outputs->current_limit / LIMIT_FULL_SCALE);
  write_share(PIN_VOLTAGE, (outputs->voltage - VOLTAGE_AT_ZERO) / (VOLTAGE_FULL_SCALE - VOLTAGE_AT_ZERO));
  if (outputs->precharge)
    switch_pin(PIN_PRECHARGE, true);
  if (outputs->contactor)
    switch_pin(PIN_CONTACTOR, true);
}

static void begin_look(bool drive)
{
  switch_pin(PIN_PROBE, drive);
  driving = drive;
  probe_began = micros();
}

void probe_start(void *)
{
  begin_look(false);
  probing = true;
}

/* Return whether exactly one of trimmer and PWM is named: what limits the voltage must be known. */
static bool stage_is_declared()
{
  return wired(PIN_VOLTAGE) != (STAGE_VOLTAGE > 0.0f);
}

/* The first look: whether the port has a voltage of its own. */
static bool look(float *resistance, float *target)
{
  *target = stage_is_declared() ? value_of(TARGET) : NAN;
  *resistance = NAN;
  if (fabsf(*target) < DC_LIVE_VOLTAGE) { /* not for NaN */
    begin_look(true);
    return false;
  }
  return true;
}

/* The driven look, at the end of its curve. */
static void measure(float *resistance, float *target)
{
  const float current = value_of(PROBE_CURRENT);
  const float voltage = value_of(PROBE_VOLTAGE);
  switch_pin(PIN_PROBE, false);
  *target = value_of(TARGET);
  *resistance = current < PROBE_OPEN_CURRENT ? INFINITY : voltage / current; /* NaN if one is unknown */
  if (*target > PROBE_SOURCE || *target <= -DC_LIVE_VOLTAGE)
    *resistance = NAN; /* a battery has connected since the first look */
}

bool probe_poll(void *, float *resistance, float *target)
{
  /* Signed, because micros() can step back by a millisecond, which must not end a wait that has just begun. */
  const int32_t waits = (int32_t)(driving ? PROBE_SETTLE_US : PROBE_LOOK_US);
  if (!probing || (int32_t)(micros() - probe_began) < waits)
    return false;
  if (driving)
    measure(resistance, target);
  else if (!look(resistance, target))
    return false;
  probe_stop(NULL);
  return true;
}

void probe_stop(void *)
{
  switch_pin(PIN_PROBE, false);
  probing = driving = false;
}
