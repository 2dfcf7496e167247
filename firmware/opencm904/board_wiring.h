/* SPDX-License-Identifier: Apache-2.0 */
/* Pins and scales of all connections: FILL IN THIS FILE for a real board.
 *
 * As delivered nothing is wired. The board then speaks the complete link, but every taxel is dead, voltages and
 * currents are unknown (NaN), a probe measures nothing and a close is refused. Each part that is filled in works. */
#ifndef BOARD_WIRING_H
#define BOARD_WIRING_H

#include <math.h>
#include <stdint.h>

const uint8_t UNWIRED = 255;

/* The link. Serial3 is a UART on pins 24 (TX) and 25 (RX), 3.3 V; Serial is USB. */
#define LINK_UART Serial3
#define LINK_OVER_USB 0
const uint32_t LINK_BAUD = 1000000; /* exact with the core's 36 and 72 MHz peripheral clocks */

/* The servos' bus on this board's connector: 1 = one cable serves servos and pads, 0 = the servos have their own
 * adapter. Serial1 is the UART of the connector, channel 0 the driver's direction. Supply the servos with
 * 12 V. */
#define SERVOS_ON_BOARD 0
#define SERVO_UART Serial1
#define SERVO_CHANNEL 0

/* Two pads of 10 x 10. Four address pins select the driven row and four the sensed column, on both pads
 * at once (two 16-channel analog multiplexers each); each pad has one analog output. Lowest bit first; row 0 is at +y,
 * column 0 at +x of the end effector. */
const uint8_t PIN_ROW[4] = {UNWIRED, UNWIRED, UNWIRED, UNWIRED};
const uint8_t PIN_COLUMN[4] = {UNWIRED, UNWIRED, UNWIRED, UNWIRED};
const uint8_t PIN_PAD_LEFT = UNWIRED;  /* the pad at +x; analog pins are 0 to 9 */
const uint8_t PIN_PAD_RIGHT = UNWIRED; /* the pad at -x */
const uint32_t TAXEL_SETTLE_US = 3;    /* from the address to a steady output */
const float TAXEL_ZERO = 0.0f;         /* counts of 4096 without force */
const float TAXEL_SCALE = NAN;         /* N per count */
const uint16_t TAXEL_LOWEST = 0;       /* counts; a taxel outside these two is dead: a broken line reads a rail */
const uint16_t TAXEL_HIGHEST = 4095;

/* Analog readings of the power stage: value = (counts - zero) * scale. A reversed target needs a zero in the range. */
struct AnalogInput {
  uint8_t pin;
  float zero;  /* counts of 4096 */
  float scale; /* V or A per count */
};
const AnalogInput BATTERY = {UNWIRED, 0.0f, NAN};
const AnalogInput TARGET = {UNWIRED, 0.0f, NAN};  /* at the electrodes */
const AnalogInput OUTPUT_SIDE = {UNWIRED, 0.0f, NAN}; /* between the stage and the contactor */
const AnalogInput CURRENT = {UNWIRED, 0.0f, NAN}; /* positive into the target */

/* Digital signals of the power stage, all active high. Each output needs its own pull-down: while the processor is in
 * reset, starts or is being flashed, its pins float, and that must mean off. */
const uint8_t PIN_CONTACTOR = UNWIRED;
const uint8_t PIN_PRECHARGE = UNWIRED;
const uint8_t PIN_FEEDBACK = UNWIRED;   /* auxiliary contact: high = closed */
const uint8_t PIN_OVERCURRENT = UNWIRED; /* comparator: high = trip */
const uint8_t PIN_LIMIT = UNWIRED;      /* PWM into the current limiter */
const float LIMIT_FULL_SCALE = NAN;     /* A at 100 % */

/* The stage: a converter with constant current and constant voltage. Its constant voltage ends every charge, so the host
 * compares it with the target before it touches. A trimmer sets it: turn it with nothing connected, measure at the
 * electrodes' leads and write it down here, V. Or this board sets it for every target: PWM through a filter into the
 * converter's feedback; then leave NAN and name the pin. Give one of the two: with none or both, no probe succeeds and
 * nothing closes. */
const bool STAGE_STEPS_UP = true;   /* false: it charges only targets below its battery's voltage less 0.5 V */
const float STAGE_VOLTAGE = NAN;
const uint8_t PIN_VOLTAGE = UNWIRED;
const float VOLTAGE_AT_ZERO = 0.0f;   /* V at 0 %, less than any target's full voltage */
const float VOLTAGE_FULL_SCALE = NAN; /* V at 100 % */

/* A, of the fuse between battery and stage. A stage that steps up draws more than it gives: 18 A into 29 V take 25 A
 * from 22.7 V. The board lowers the current instead of blowing the fuse. */
const float INPUT_FUSE = 20.0f;

/* The probe: a source of at most 5 V and 50 mA that PIN_PROBE connects to the electrodes, and the current it drives. A
 * live battery may connect while it is on, so a diode or the like must keep that out of the source. It looks first
 * without driving: a port with a voltage of its own is not driven at all. */
const uint8_t PIN_PROBE = UNWIRED;
const AnalogInput PROBE_VOLTAGE = {UNWIRED, 0.0f, NAN};
const AnalogInput PROBE_CURRENT = {UNWIRED, 0.0f, NAN};
const uint32_t PROBE_LOOK_US = 20000;    /* from the start to the voltage of the port alone */
const uint32_t PROBE_SETTLE_US = 100000; /* from switching on to measuring; together at most 200 000 */
const float PROBE_OPEN_CURRENT = 1e-4f;  /* A; below it the circuit is open */

/* Limits of this installation; the electrodes carry 18 A. */
const float CURRENT_LIMIT = 18.0f;
const float LOWEST_TARGET = 10.0f;  /* V */
const float HIGHEST_TARGET = 30.0f;
const float LOWEST_BATTERY = 22.7f; /* V, the charger's own; as docking_node's battery_voltage_min and _max */
const float HIGHEST_BATTERY = 29.8f;

/* Longest time between two polls, us: three scans of both pads (two of a tare, one of a frame), the arithmetic and half a
 * millisecond of sending to the servos. Measure it on the board. */
const uint32_t POLL_PERIOD_US = 12000;

/* Counts of a 40 kHz / 32 clock with a tolerance of about half: 24 to 48 ms without a poll reset the board. */
const uint16_t WATCHDOG_COUNTS = 45;

#endif
