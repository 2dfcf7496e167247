/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_contactor.h"

#include "dc_float.h"
#include "dc_packet.h"

static void read_power(dc_contactor *contactor)
{
    const dc_hardware *hardware = contactor->stage.hardware;
    hardware->read_power(hardware->context, &contactor->reading);
}

static void end_probe(dc_contactor *contactor)
{
    const dc_hardware *hardware = contactor->stage.hardware;
    hardware->stop_probe(hardware->context);
    contactor->probing = false;
}

static void abort_probe(dc_contactor *contactor)
{
    if (contactor->probing) {
        end_probe(contactor);
        contactor->probe_aborted = true;
    }
}

/* Common part of every opening, whatever its cause. */
static void void_probe(dc_contactor *contactor)
{
    contactor->closed = false;
    contactor->probe_valid_until = 0;
    abort_probe(contactor);
}

void dc_contactor_reset(dc_contactor *contactor, const dc_hardware *hardware, const dc_config *config, uint64_t now)
{
    dc_stage_reset(&contactor->stage, hardware, config, now);
    end_probe(contactor);
    contactor->probe_aborted = false;
    contactor->closed = false;
    contactor->fault = hardware->load(hardware->context) == DC_CONTACTOR_WELDED ? DC_CONTACTOR_WELDED : DC_NO_FAULT;
    contactor->probe_answer_due = contactor->probe_valid_until = contactor->heartbeat_deadline = 0;
    contactor->port = DC_PORT_UNKNOWN;
    contactor->next_check = now;
    contactor->sum = contactor->least = contactor->voltages = 0.0f;
    contactor->measured = contactor->flowing = 0;
    read_power(contactor);
}

void dc_contactor_heartbeat(dc_contactor *contactor, uint64_t now)
{
    const uint32_t period = dc_poll_period(contactor->stage.config);
    contactor->heartbeat_deadline =
        now + DC_HEARTBEAT_TIMEOUT_US - (period < DC_HEARTBEAT_MARGIN_US ? period : DC_HEARTBEAT_MARGIN_US);
}

/* Return whether the last probe allows a close. */
static bool probe_allows(const dc_contactor *contactor, uint64_t now, bool dead)
{
    if (now >= contactor->probe_valid_until)
        return false;
    if (contactor->port == DC_PORT_LIVE)
        return true;
    return dead && (contactor->port == DC_PORT_OPEN || contactor->port == DC_PORT_DEAD);
}

uint8_t dc_contactor_close(dc_contactor *contactor, uint64_t now, const dc_limits *limits)
{
    if (contactor->closed)
        return DC_NOT_NOW;
    if (now >= contactor->heartbeat_deadline || contactor->fault != DC_NO_FAULT ||
        !probe_allows(contactor, now, limits->dead) ||
        contactor->stage.config->stage_voltage > limits->voltage + DC_STAGE_TOLERANCE)
        return DC_INTERLOCK;
    abort_probe(contactor); /* the probe's circuit must leave the electrodes before the battery is connected */
    contactor->closed = true;
    contactor->next_check = now + DC_CHECK_PERIOD_US;
    dc_stage_close(&contactor->stage, now, limits);
    return DC_DONE;
}

uint8_t dc_contactor_limit(dc_contactor *contactor, float current)
{
    if (!contactor->closed)
        return DC_NOT_NOW;
    contactor->stage.limits.current = current;
    contactor->next_check = 0; /* a lower limit counts now */
    return DC_DONE;
}

void dc_contactor_open(dc_contactor *contactor, uint64_t now)
{
    dc_stage_open(&contactor->stage, now, true);
    void_probe(contactor);
    if (contactor->fault != DC_CONTACTOR_WELDED)
        contactor->fault = DC_NO_FAULT;
}

static bool is_dead(const dc_power_reading *reading)
{
    return !reading->contactor_closed && dc_absolute(reading->current) < DC_ZERO_CURRENT &&
           !(dc_absolute(reading->target) >= DC_DEAD_VOLTAGE);
}

uint8_t dc_contactor_clear_weld(dc_contactor *contactor)
{
    const dc_hardware *hardware = contactor->stage.hardware;
    const bool other = contactor->fault != DC_NO_FAULT && contactor->fault != DC_CONTACTOR_WELDED;
    if (other || contactor->closed)
        return DC_NOT_NOW;
    read_power(contactor);
    if (!is_dead(&contactor->reading))
        return DC_INTERLOCK;
    if (contactor->fault == DC_CONTACTOR_WELDED)
        hardware->save(hardware->context, DC_NO_FAULT);
    contactor->fault = DC_NO_FAULT;
    return DC_DONE;
}

/* Return whether `fault` replaces the latched one: nothing may hide a weld. */
static bool outranks(uint8_t fault, uint8_t latched)
{
    return latched == DC_NO_FAULT ? fault != DC_NO_FAULT : fault == DC_CONTACTOR_WELDED && latched != fault;
}

void dc_contactor_trip(dc_contactor *contactor, uint8_t fault, uint64_t now)
{
    dc_stage_open(&contactor->stage, now, false);
    void_probe(contactor);
    if (!outranks(fault, contactor->fault))
        return;
    contactor->fault = fault;
    if (fault == DC_CONTACTOR_WELDED)
        contactor->stage.hardware->save(contactor->stage.hardware->context, fault);
}

uint8_t dc_contactor_start_probe(dc_contactor *contactor, uint64_t now)
{
    const dc_hardware *hardware = contactor->stage.hardware;
    if (contactor->fault != DC_NO_FAULT)
        return DC_INTERLOCK;
    if (contactor->closed || contactor->probing || contactor->stage.state != DC_OPEN)
        return DC_NOT_NOW;
    read_power(contactor);
    if (contactor->reading.contactor_closed)
        return DC_NOT_NOW;
    if (dc_absolute(contactor->reading.current) >= DC_ZERO_CURRENT)
        return DC_INTERLOCK;
    contactor->probing = true;
    contactor->probe_answer_due = now + DC_PROBE_TIMEOUT_US - dc_poll_period(contactor->stage.config);
    hardware->start_probe(hardware->context);
    return DC_DONE;
}

static dc_port port_of(float resistance, float voltage)
{
    if (dc_is_nan(resistance)) {
        if (!(dc_absolute(voltage) >= DC_LIVE_VOLTAGE))
            return DC_PORT_UNKNOWN;
        return voltage > 0.0f ? DC_PORT_LIVE : DC_PORT_REVERSED;
    }
    if (!dc_is_finite(resistance))
        return DC_PORT_OPEN;
    if (dc_is_nan(voltage))
        return DC_PORT_UNKNOWN;
    return resistance < DC_SHORT_RESISTANCE ? DC_PORT_SHORT : DC_PORT_DEAD;
}

dc_probe_event dc_contactor_poll_probe(dc_contactor *contactor, uint64_t now, float *resistance, float *target)
{
    const dc_hardware *hardware = contactor->stage.hardware;
    if (contactor->probe_aborted) {
        contactor->probe_aborted = false;
        return DC_PROBE_ABORTED;
    }
    if (!contactor->probing)
        return DC_PROBE_NONE;
    if (!hardware->poll_probe(hardware->context, resistance, target)) {
        if (now < contactor->probe_answer_due)
            return DC_PROBE_NONE;
        *resistance = *target = DC_NAN; /* not measured in time */
    }
    end_probe(contactor);
    contactor->port = port_of(*resistance, *target);
    contactor->probe_valid_until = now + DC_PROBE_LIFETIME_US;
    return DC_PROBE_DONE;
}

static void add_reading(dc_contactor *contactor)
{
    const float current = contactor->reading.current, target = contactor->reading.target;
    if (!dc_is_finite(current))
        return;
    if (current >= DC_IDLE_CURRENT && dc_is_finite(target)) {
        contactor->voltages += target;
        contactor->flowing++;
    }
    if (contactor->measured == 0 || current < contactor->least)
        contactor->least = current;
    contactor->sum += current;
    contactor->measured++;
}

void dc_contactor_report(dc_contactor *contactor, float *mean, float *least, float *target)
{
    const bool none = contactor->measured == 0;
    *mean = none ? DC_NAN : contactor->sum / (float)contactor->measured;
    *least = none ? DC_NAN : contactor->least;
    *target = contactor->flowing == 0 ? contactor->reading.target : contactor->voltages / (float)contactor->flowing;
    contactor->sum = contactor->voltages = 0.0f;
    contactor->measured = contactor->flowing = 0;
}

static void check(dc_contactor *contactor, uint64_t now)
{
    read_power(contactor);
    add_reading(contactor);
    const uint8_t shown = dc_stage_step(&contactor->stage, now, &contactor->reading);
    const bool told = contactor->reading.fault != DC_NO_FAULT && shown != DC_CONTACTOR_WELDED;
    uint8_t fault = told ? contactor->reading.fault : shown;
    if (fault == DC_NO_CHARGE_CURRENT && !contactor->closed)
        fault = DC_NO_FAULT; /* after an opening no current is expected */
    if (outranks(fault, contactor->fault)) {
        dc_contactor_trip(contactor, fault, now);
        read_power(contactor);
    } else if (contactor->closed && contactor->stage.dropped_out) {
        void_probe(contactor);
    }
    if (contactor->stage.state == DC_CLOSED || contactor->stage.state == DC_RAMPING_DOWN)
        contactor->reading.contactor_closed = true; /* an open feedback is a bounce, and no opening */
    const bool busy = contactor->stage.state != DC_OPEN || contactor->reading.contactor_closed;
    contactor->next_check = now + (busy ? DC_CHECK_PERIOD_US : DC_IDLE_CHECK_PERIOD_US);
}

void dc_contactor_poll(dc_contactor *contactor, uint64_t now)
{
    if (contactor->closed && now >= contactor->heartbeat_deadline)
        dc_contactor_trip(contactor, DC_HEARTBEAT_LOST, now);
    if (now >= contactor->next_check)
        check(contactor, now);
}

uint64_t dc_contactor_next_event(const dc_contactor *contactor, uint64_t now)
{
    uint64_t due = contactor->next_check;
    if (contactor->closed && contactor->heartbeat_deadline < due)
        due = contactor->heartbeat_deadline;
    if (contactor->probe_aborted)
        due = now;
    else if (contactor->probing && now + DC_CHECK_PERIOD_US < due)
        due = now + DC_CHECK_PERIOD_US;
    return due;
}
