/* SPDX-License-Identifier: Apache-2.0 */
#include "dc_pads.h"

#include <stddef.h>
#include <string.h>

#include "dc_float.h"
#include "dc_schedule.h"

void dc_pads_reset(dc_pads *pads)
{
    memset(pads, 0, sizeof *pads);
    for (size_t i = 0; i < DC_TAXELS; i++)
        pads->baseline[i] = DC_NAN;
    pads->tare_due = DC_NEVER;
}

void dc_pads_apply(const dc_pads *pads, float forces[DC_TAXELS])
{
    if (!pads->tared)
        return;
    for (size_t i = 0; i < DC_TAXELS; i++)
        forces[i] = dc_is_nan(pads->baseline[i]) ? DC_NAN : forces[i] - pads->baseline[i];
}

/* Converts floats to integers of the same order, and back: a Cortex-M3 compares integers ten times faster. */
static uint32_t key_of(float value)
{
    const uint32_t bits = dc_bits_of_float(value);
    return bits >> 31 ? ~bits : bits | 0x80000000u;
}

static float value_of(uint32_t key)
{
    return dc_float_of_bits(key >> 31 ? key & 0x7FFFFFFFu : ~key);
}

/* Shell sort: it runs between two checks of the contactor, so its worst case matters. */
static void sort(uint32_t *keys, size_t count)
{
    static const uint8_t GAPS[] = {57, 23, 10, 4, 1};
    for (size_t g = 0; g < sizeof GAPS; g++) {
        const size_t gap = GAPS[g];
        for (size_t i = gap; i < count; i++) {
            const uint32_t key = keys[i];
            size_t at = i;
            for (; at >= gap && keys[at - gap] > key; at -= gap)
                keys[at] = keys[at - gap];
            keys[at] = key;
        }
    }
}

/* Median of a pad's live taxels, N; 0 for a pad without any. */
static float median(const float pad[DC_PAD])
{
    uint32_t keys[DC_PAD];
    size_t count = 0;
    for (size_t i = 0; i < DC_PAD; i++)
        if (!dc_is_nan(pad[i]))
            keys[count++] = key_of(pad[i]);
    if (count == 0)
        return 0.0f;
    sort(keys, count);
    return (value_of(keys[(count - 1) / 2]) + value_of(keys[count / 2])) / 2.0f;
}

static bool any_unknown(const float baseline[DC_PAD])
{
    for (size_t i = 0; i < DC_PAD; i++)
        if (dc_is_nan(baseline[i]))
            return true;
    return false;
}

bool dc_pads_loaded(const dc_pads *pads, const float raw[DC_TAXELS])
{
    for (size_t pad = 0; pad < DC_TAXELS; pad += DC_PAD) {
        /* Without a tare, the resting value of a taxel may come near 1 N. The pad's median replaces the baseline,
         * because contact covers only a quarter of a pad. */
        const float resting = any_unknown(pads->baseline + pad) ? median(raw + pad) : 0.0f;
        for (size_t i = pad; i < pad + DC_PAD; i++) {
            const float baseline = dc_is_nan(pads->baseline[i]) ? resting : pads->baseline[i];
            if (!dc_is_nan(raw[i]) && raw[i] - baseline >= DC_CONTACT_FORCE)
                return true;
        }
    }
    return false;
}

bool dc_pads_start_tare(dc_pads *pads, const dc_hardware *hardware, uint64_t now)
{
    float forces[DC_TAXELS];
    if (pads->tare_due != DC_NEVER)
        return false;
    hardware->read_taxels(hardware->context, forces);
    if (dc_pads_loaded(pads, forces))
        return false;
    memset(pads->sum, 0, sizeof pads->sum);
    memset(pads->live, 0, sizeof pads->live);
    pads->taken = 0;
    pads->tare_due = now;
    return true;
}

static void finish(dc_pads *pads)
{
    for (size_t i = 0; i < DC_TAXELS; i++)
        pads->baseline[i] = pads->live[i] > 0 ? pads->sum[i] / (float)pads->live[i] : DC_NAN;
    pads->tared = true;
    pads->tare_due = DC_NEVER;
}

dc_tare_result dc_pads_poll_tare(dc_pads *pads, const dc_hardware *hardware, uint64_t now)
{
    float forces[DC_TAXELS];
    if (now < pads->tare_due)
        return DC_TARE_NONE;
    hardware->read_taxels(hardware->context, forces);
    if (dc_pads_loaded(pads, forces)) {
        pads->tare_due = DC_NEVER;
        return DC_TARE_REFUSED;
    }
    for (size_t i = 0; i < DC_TAXELS; i++) {
        if (!dc_is_nan(forces[i])) {
            pads->sum[i] += forces[i];
            pads->live[i]++;
        }
    }
    pads->tare_due = now + DC_TARE_PERIOD_US;
    if (++pads->taken < DC_TARE_SAMPLES)
        return DC_TARE_NONE;
    finish(pads);
    return DC_TARE_DONE;
}
