/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_stage.h"

#include "dc_float.h"
#include "dc_packet.h"

static void drive(dc_stage *stage, bool precharge, bool contactor, float limit)
{
    stage->outputs.precharge = precharge;
    stage->outputs.contactor = contactor;
    stage->outputs.current_limit = limit;
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

void dc_stage_close(dc_stage *stage, uint64_t now)
{
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

static uint8_t precharge(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    if (reading->target < stage->config->lowest_target || reading->target > stage->config->highest_target)
        return DC_VOLTAGE_OUT_OF_RANGE;
    if (dc_absolute(reading->output - reading->target) <= DC_PRECHARGE_MATCH) {
        enter(stage, DC_CLOSING, now);
        drive(stage, true, true, 0.0f);
        return DC_NO_FAULT;
    }
    if (now - stage->since < DC_PRECHARGE_TIMEOUT_US)
        return DC_NO_FAULT;
    if (dc_is_nan(reading->target))
        return DC_NO_CHARGE_CURRENT; /* nothing is connected */
    return dc_is_nan(reading->output) ? DC_STALE : DC_VOLTAGE_OUT_OF_RANGE;
}

static uint8_t pull_in(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    if (reading->contactor_closed) {
        enter(stage, DC_CLOSED, now);
        stage->flowing = stage->seen = stage->target_good = stage->battery_good = stage->battery_full = now;
        stage->flowed = false;
        stage->bounce = now - DC_BOUNCE_PERIOD_US; /* contacts bounce most when they close */
        drive(stage, false, true, 0.0f);
    } else if (now - stage->since >= DC_PULL_IN_TIMEOUT_US) {
        return DC_NO_CHARGE_CURRENT;
    }
    return DC_NO_FAULT;
}

/* Faults that open at once, whatever the feedback shows; a cause before its consequence. Comparisons with NaN are
 * false. */
static uint8_t at_once(const dc_power_reading *reading)
{
    if (reading->target < 0.0f)
        return DC_REVERSE_POLARITY;
    if (reading->current > DC_OPEN_CURRENT && reading->target < DC_SHORT_VOLTAGE)
        return DC_SHORT_CIRCUIT;
    if (reading->current > DC_LARGEST_CURRENT)
        return DC_OVER_CURRENT;
    return reading->current < DC_REVERSE_LIMIT ? DC_REVERSE_CURRENT : DC_NO_FAULT;
}

/* Return whether `good` has not held for `longest` us; `last` is when it last did. */
static bool lapsed(uint64_t *last, uint64_t now, bool good, uint32_t longest)
{
    if (good)
        *last = now;
    return now - *last >= longest;
}

/* Readings that must not stay unknown or out of range while the contactor is closed. */
static uint8_t watch(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    const dc_config *config = stage->config;
    const float target = reading->target, battery = reading->battery;
    const bool in_range = target >= config->lowest_target && target <= config->highest_target;
    if (lapsed(&stage->seen, now, dc_is_finite(reading->current), DC_BLIND_TIMEOUT_US))
        return DC_STALE;
    if (lapsed(&stage->target_good, now, in_range, DC_BLIND_TIMEOUT_US))
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

static uint8_t charge(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    if (reading->current >= DC_IDLE_CURRENT) {
        stage->flowing = now;
        stage->flowed = true;
    } else if (dc_is_finite(reading->current) &&
               now - stage->flowing >= (stage->flowed ? DC_LOST_TIMEOUT_US : DC_IDLE_TIMEOUT_US)) {
        return DC_NO_CHARGE_CURRENT;
    }
    float limit = stage->outputs.current_limit + DC_RAMP_UP * 1e-6f * (float)(now - stage->stepped);
    if (limit > stage->config->current_limit)
        limit = stage->config->current_limit;
    if (limit > stage->outputs.current_limit)
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
    uint8_t fault = stage->state == DC_OPEN ? DC_NO_FAULT : at_once(reading);
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
