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
    stage->flowing = stage->seen = now;
    stage->flowed = stage->dropped_out = false;
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

static uint8_t voltage_fault(const dc_stage *stage, float target)
{
    if (target < 0.0f)
        return DC_REVERSE_POLARITY;
    if (target < stage->config->lowest_target || target > stage->config->highest_target)
        return DC_VOLTAGE_OUT_OF_RANGE;
    return DC_NO_FAULT;
}

static uint8_t precharge(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    const uint8_t fault = voltage_fault(stage, reading->target);
    if (fault != DC_NO_FAULT)
        return fault;
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
        stage->flowing = stage->seen = now;
        stage->flowed = false;
        drive(stage, false, true, 0.0f);
    } else if (now - stage->since >= DC_PULL_IN_TIMEOUT_US) {
        return DC_NO_CHARGE_CURRENT;
    }
    return DC_NO_FAULT;
}

/* Faults of a closed contactor in any state. Comparisons with NaN are false. */
static uint8_t watch(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    if (reading->current > DC_LARGEST_CURRENT)
        return DC_OVER_CURRENT;
    if (reading->current < DC_REVERSE_LIMIT)
        return DC_REVERSE_CURRENT;
    if (reading->target < 0.0f)
        return DC_REVERSE_POLARITY;
    if (reading->current > DC_OPEN_CURRENT && reading->target < DC_SHORT_VOLTAGE)
        return DC_SHORT_CIRCUIT;
    if (reading->target > stage->config->highest_target)
        return DC_VOLTAGE_OUT_OF_RANGE;
    if (dc_is_finite(reading->current))
        stage->seen = now;
    return now - stage->seen >= DC_BLIND_TIMEOUT_US ? DC_STALE : DC_NO_FAULT;
}

static uint8_t charge(dc_stage *stage, uint64_t now, const dc_power_reading *reading)
{
    if (reading->current >= DC_IDLE_CURRENT || dc_is_nan(reading->current)) {
        stage->flowing = now;
        stage->flowed = stage->flowed || !dc_is_nan(reading->current);
    }
    if (now - stage->flowing >= (stage->flowed ? DC_LOST_TIMEOUT_US : DC_IDLE_TIMEOUT_US))
        return DC_NO_CHARGE_CURRENT;
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
    uint8_t fault = DC_NO_FAULT;
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
        if (!reading->contactor_closed) {
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
