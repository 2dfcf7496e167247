/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_stage.h"

#include "dc_float.h"
#include "dc_packet.h"

static void drive(dc_stage *stage, bool precharge, bool contactor, float limit)
{
    stage->outputs.precharge = precharge;
    stage->outputs.contactor = contactor;
    stage->outputs.current_limit = limit;
    stage->outputs.voltage = 0.0f;
    if ((precharge || contactor) && dc_is_nan(stage->config->stage_voltage))
        stage->outputs.voltage = stage->limits.voltage;
    stage->hardware->set_outputs(stage->hardware->context, &stage->outputs);
}

static void enter(dc_stage *stage, dc_stage_state state, uint64_t now)
{
    stage->state = state;
    stage->since = stage->stepped = now;
}

static void switch_off(dc_stage *stage, uint64_t now)
{
    drive(stage, false, false, 0.0f);
    if (stage->state != DC_OPEN)
        enter(stage, DC_OPEN, now);
}

void dc_stage_reset(dc_stage *stage, const dc_hardware *hardware, const dc_config *config, uint64_t now)
{
    stage->hardware = hardware;
    stage->config = config;
    stage->dropped_out = false;
    enter(stage, DC_OPEN, now);
    drive(stage, false, false, 0.0f);
}

void dc_stage_close(dc_stage *stage, uint64_t now, const dc_limits *limits)
{
    stage->limits = *limits;
    stage->started = !limits->dead;
    stage->forward = now;
    stage->dropped_out = false;
    enter(stage, DC_PRECHARGE, now);
    drive(stage, true, false, 0.0f);
}

void dc_stage_open(dc_stage *stage, uint64_t now, bool ramp)
{
    if (!ramp || (stage->state != DC_CLOSED && stage->state != DC_RAMPING_DOWN))
        switch_off(stage, now);
    else if (stage->state == DC_CLOSED)
        enter(stage, DC_RAMPING_DOWN, now);
}

/* A NaN in `b` changes nothing. */
static float smaller(float a, float b)
{
    return b < a ? b : a;
}

static uint8_t precharge(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    const dc_config *config = stage->config;
    const dc_limits *limits = &stage->limits;
    const float target = limits->dead && dc_is_nan(reading->target) ? 0.0f : reading->target;
    const bool too_low = !limits->dead && target < config->lowest_target;
    const bool too_high = target > smaller(config->highest_target, limits->voltage);
    if (too_low || too_high || (!config->steps_up && target > reading->battery - DC_STEP_DOWN))
        return DC_VOLTAGE_OUT_OF_RANGE;
    if (dc_absolute(reading->output - target) <= DC_PRECHARGE_MATCH) {
        enter(stage, DC_CLOSING, now);
        drive(stage, true, true, 0.0f);
        return DC_NO_FAULT;
    }
    if (now - stage->since < DC_PRECHARGE_TIMEOUT_US)
        return DC_NO_FAULT;
    if (dc_is_nan(target))
        return DC_NO_CHARGE_CURRENT; /* nothing is connected */
    return dc_is_nan(reading->output) ? DC_STALE : DC_VOLTAGE_OUT_OF_RANGE;
}

static uint8_t pull_in(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    if (reading->contactor_closed) {
        enter(stage, DC_CLOSED, now);
        stage->flowing = stage->rising = stage->seen = now;
        stage->target_good = stage->battery_good = stage->battery_full = now;
        stage->flowed = false;
        stage->bounce = now - DC_BOUNCE_PERIOD_US; /* contacts bounce most when they close */
        drive(stage, false, true, 0.0f);
    } else if (now - stage->since >= DC_PULL_IN_TIMEOUT_US) {
        return DC_NO_CHARGE_CURRENT;
    }
    return DC_NO_FAULT;
}

/* Return whether `good` has not held for `longest` us; `last` is when it last did. */
static bool lapsed(uint64_t *last, uint64_t now, bool good, uint32_t longest)
{
    if (good)
        *last = now;
    return now - *last >= longest;
}

/* Faults that open at once, whatever the feedback shows; a cause before its consequence. Comparisons with NaN are
 * false. */
static uint8_t at_once(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    const bool forward = reading->current >= DC_REVERSE_LIMIT;
    const bool lasts = lapsed(&stage->forward, now, forward, DC_BLIND_TIMEOUT_US);
    if (reading->target <= DC_REVERSED)
        return DC_REVERSE_POLARITY;
    if (reading->current > DC_OPEN_CURRENT && reading->target < DC_SHORT_VOLTAGE)
        return DC_SHORT_CIRCUIT;
    if (reading->current > DC_LARGEST_CURRENT)
        return DC_OVER_CURRENT;
    return reading->current < (lasts ? DC_REVERSE_LIMIT : DC_REVERSE_AT_ONCE) ? DC_REVERSE_CURRENT : DC_NO_FAULT;
}

/* The target's voltage; a dead port has none until it starts. */
static bool in_range(const dc_stage *stage, const dc_power_reading *reading)
{
    const dc_config *config = stage->config;
    const float highest = smaller(config->highest_target, stage->limits.voltage + DC_OVER_VOLTAGE);
    return reading->target <= highest && (!stage->started || reading->target >= config->lowest_target);
}

/* Readings that must not stay unknown or out of range while the contactor is closed. */
static uint8_t watch(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    const dc_config *config = stage->config;
    const float target = reading->target, battery = reading->battery;
    if (lapsed(&stage->seen, now, dc_is_finite(reading->current), DC_BLIND_TIMEOUT_US))
        return DC_STALE;
    if (lapsed(&stage->target_good, now, in_range(stage, reading), DC_BLIND_TIMEOUT_US))
        return dc_is_nan(target) ? DC_STALE : DC_VOLTAGE_OUT_OF_RANGE;
    if (lapsed(&stage->battery_good, now, battery <= config->highest_battery, DC_BLIND_TIMEOUT_US))
        return dc_is_nan(battery) ? DC_STALE : DC_VOLTAGE_OUT_OF_RANGE;
    if (lapsed(&stage->battery_full, now, battery >= config->lowest_battery, DC_SAG_TIMEOUT_US))
        return DC_VOLTAGE_OUT_OF_RANGE;
    return DC_NO_FAULT;
}

/* Return whether the contactor has opened on its own. Contacts bounce: TE names 5 ms at most for its EVC135, Durakool 7 ms
 * for its DEVR40. */
static bool has_opened(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    if (reading->contactor_closed)
        return false;
    if (now - stage->bounce >= DC_BOUNCE_PERIOD_US)
        stage->bounce = now;
    return now - stage->bounce >= DC_BOUNCE_TIME_US;
}

/* Current that has not begun in time, or has not returned. A dead port must also show a voltage in time. */
static uint8_t missing(const dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    if (!dc_is_finite(reading->current))
        return DC_NO_FAULT; /* see watch() */
    if (stage->started && stage->flowed)
        return now - stage->flowing >= stage->limits.gap_us ? DC_NO_CHARGE_CURRENT : DC_NO_FAULT;
    if (now - stage->since < stage->limits.start_us)
        return DC_NO_FAULT;
    if (reading->current < DC_IDLE_CURRENT)
        return DC_NO_CHARGE_CURRENT;
    return reading->target < DC_SHORT_VOLTAGE ? DC_SHORT_CIRCUIT : DC_VOLTAGE_OUT_OF_RANGE;
}

/* Return the largest current allowed now, A. What the battery gives through the fuse is less at the target's voltage. */
static float largest_current(const dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    const float target = reading->target > 1.0f ? reading->target : 1.0f;
    float largest = smaller(stage->config->current_limit, stage->limits.current);
    largest = smaller(largest, DC_FUSE_SHARE * stage->config->input_fuse * reading->battery / target);
    if (!stage->started)
        largest = smaller(largest, DC_START_CURRENT);
    if (now - stage->flowing >= DC_LOST_TIMEOUT_US)
        largest = smaller(largest, DC_GAP_CURRENT);
    return largest > 0.0f ? largest : 0.0f;
}

static uint8_t charge(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    const bool flows = reading->current >= DC_IDLE_CURRENT;
    if (flows) {
        stage->flowing = now;
        stage->flowed = true;
    }
    if (!flows || !(reading->target >= stage->config->lowest_target))
        stage->rising = now;
    if (now - stage->rising >= DC_START_TIME_US)
        stage->started = true;
    const uint8_t fault = missing(stage, now, reading);
    if (fault != DC_NO_FAULT)
        return fault;
    const bool known = dc_is_finite(reading->battery) && (!stage->started || dc_is_finite(reading->target));
    const float rise = known ? DC_RAMP_UP * 1e-6f * (float)(now - stage->stepped) : 0.0f;
    const float limit = smaller(stage->outputs.current_limit + rise, largest_current(stage, now, reading));
    if (limit < stage->outputs.current_limit || limit > stage->outputs.current_limit)
        drive(stage, false, true, limit);
    return DC_NO_FAULT;
}

static void ramp_down(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    const uint64_t allowed = DC_RAMP_DOWN_TIMEOUT_US - dc_poll_period(stage->config);
    if (reading->current < DC_OPEN_CURRENT || now - stage->since >= allowed) {
        switch_off(stage, now);
        return;
    }
    float limit = stage->outputs.current_limit;
    if (reading->current < limit)
        limit = reading->current; /* a limit far above the current would not come down to it in time */
    limit -= DC_RAMP_DOWN * 1e-6f * (float)(now - stage->stepped);
    drive(stage, false, true, limit > 0.0f ? limit : 0.0f);
}

uint8_t dc_stage_step(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    uint8_t fault = stage->state == DC_OPEN ? DC_NO_FAULT : at_once(stage, now, reading);
    if (fault != DC_NO_FAULT)
        return fault;
    switch (stage->state) {
    case DC_OPEN:
        if (now - stage->since >= DC_ZERO_TIMEOUT_US &&
            (reading->contactor_closed || dc_absolute(reading->current) >= DC_ZERO_CURRENT))
            fault = DC_CONTACTOR_WELDED;
        break;
    case DC_PRECHARGE:
        fault = precharge(stage, now, reading);
        break;
    case DC_CLOSING:
        fault = pull_in(stage, now, reading);
        break;
    case DC_CLOSED:
    case DC_RAMPING_DOWN:
        if (has_opened(stage, now, reading)) {
            stage->dropped_out = stage->state == DC_CLOSED;
            switch_off(stage, now);
            break;
        }
        fault = watch(stage, now, reading);
        if (fault == DC_NO_FAULT && stage->state == DC_CLOSED)
            fault = charge(stage, now, reading);
        else if (fault == DC_NO_FAULT)
            ramp_down(stage, now, reading);
        break;
    }
    stage->stepped = now;
    return fault;
}
