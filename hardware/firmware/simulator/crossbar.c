// SPDX-License-Identifier: GPL-3.0-or-later
#include "crossbar.h"

#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/sim_io.h>
#include <simavr/sim_regbit.h>
#include <string.h>

#include "options.h"

#define LEAST_BITS 4  // that number wires, as the firmware has them

typedef struct {
    char port;
    int8_t bits[8];  // of the port that number wires, the lowest first; -1 behind the last
} pins_t;

static const struct {
    const char *mcu;
    pins_t row, column;
} PINS[] = {
    {"atmega328p", {'B', {0, 1, 2, 3, 4, 5, -1}}, {'D', {4, 5, 6, 7, 3, 2, -1}}},
    {"atmega2560", {'A', {0, 1, 2, 3, 4, 5, 6, -1}}, {'C', {0, 1, 2, 3, 4, 5, 6, -1}}},
};

typedef struct {
    pins_t pins;  // that are looked at: as many as the table's wires need
    uint32_t mask;
} address_t;

static const table_t *table;
static address_t row_address, column_address;
static avr_adc_t *adc;
static avr_irq_t *input;
static avr_cycle_count_t reset_at, changed_at;
static uint16_t sampled_mv;
static crossbar_statistics_t statistics = {.min_settle = UINT64_MAX};

static address_t address_of(pins_t pins, uint32_t wires)
{
    address_t address = {.pins = pins};
    int n = 0;
    while (pins.bits[n] >= 0 && (n < LEAST_BITS || wires > 1u << n))
        address.mask |= 1u << pins.bits[n++];
    address.pins.bits[n] = -1;
    return address;
}

// -1 if the firmware does not drive the pins.
static int address_from(avr_t *avr, const address_t *address)
{
    avr_ioport_state_t state = {0};
    avr_ioctl(avr, AVR_IOCTL_IOPORT_GETSTATE(address->pins.port), &state);
    if ((state.ddr & address->mask) != address->mask)
        return -1;
    int number = 0;
    for (int k = 0; address->pins.bits[k] >= 0; k++)
        number |= (int)(state.port >> address->pins.bits[k] & 1) << k;
    return number;
}

static void on_port_written(avr_irq_t *irq, uint32_t value, void *address)
{
    if ((value ^ irq->value) & ((address_t *)address)->mask)  // irq->value: as before
        changed_at = adc->io.avr->cycle;
}

static avr_cycle_count_t sample(avr_t *avr, avr_cycle_count_t when, void *channel)
{
    (void)when;
    int row = address_from(avr, &row_address), column = address_from(avr, &column_address);
    int is_bad = *(int *)channel != 0 || row < 0 || column < 0 || row >= (int)table->rows ||
                 column >= (int)table->columns;
    uint64_t device_us = (avr->cycle - reset_at) * 1000000 / avr->frequency;
    uint16_t count = is_bad ? TABLE_EMPTY : table_count(table, device_us, (uint32_t)row, (uint32_t)column);
    is_bad = count == TABLE_EMPTY;
    count = is_bad ? 0 : count;
    // Millivolts for which simavr's own conversion, floor(mV * 1023 / AVcc), gives just this count; 1024 would too.
    sampled_mv = (uint16_t)(count * (CROSSBAR_AVCC_MV / TABLE_FULL_SCALE));
    statistics.conversions++;
    statistics.bad_addresses += (uint64_t)is_bad;
    if (avr->cycle - changed_at < statistics.min_settle)
        statistics.min_settle = avr->cycle - changed_at;
    return 0;
}

static avr_cycle_count_t deliver(avr_t *avr, avr_cycle_count_t when, void *unused)
{
    (void)avr, (void)when, (void)unused;
    avr_raise_irq(input, sampled_mv);
    return 0;
}

// A real converter samples 1.5 of its clocks after a conversion starts and ends it after 13 (13.5 and 25 for the
// first). simavr takes the input's value at the moment the program reads the result; where conversions follow one
// another by themselves, the next one runs by then. So sample when the real one does, and hand the value over half
// a clock before the conversion ends, when the one before has long been read.
static void on_conversion(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    static int channel;
    avr_t *avr = adc->io.avr;
    union {
        uint32_t value;
        avr_adc_mux_t mux;
    } source = {.value = value};
    channel = source.mux.kind == ADC_MUX_SINGLE ? source.mux.src : -1;
    uint32_t shift = avr_regbit_get_array(avr, adc->adps, 3);
    avr_cycle_count_t half_clock = (1u << (shift ? shift : 1)) / 2;
    avr_cycle_timer_register(avr, (adc->first ? 27 : 3) * half_clock, sample, &channel);
    avr_cycle_timer_register(avr, (adc->first ? 49 : 25) * half_clock, deliver, NULL);
}

static avr_irq_t *port_irq(avr_t *avr, const address_t *address)
{
    return avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(address->pins.port), IOPORT_IRQ_REG_PORT);
}

void crossbar_connect(avr_t *avr, const char *mcu, const table_t *counts)
{
    table = counts;
    for (size_t k = 0; k < sizeof PINS / sizeof *PINS; k++) {
        if (strcmp(PINS[k].mcu, mcu) == 0) {
            row_address = address_of(PINS[k].row, counts->rows);
            column_address = address_of(PINS[k].column, counts->columns);
        }
    }
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (strcmp(io->kind, "adc") == 0)
            adc = (avr_adc_t *)io;  // an avr_io_t is the first member of each module
    if (!row_address.mask || !adc)
        fail("--mcu %s is unknown, expected atmega328p or atmega2560.", mcu);
    input = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), on_conversion, NULL);
    avr_irq_register_notify(port_irq(avr, &row_address), on_port_written, &row_address);
    avr_irq_register_notify(port_irq(avr, &column_address), on_port_written, &column_address);
}

void crossbar_reset(avr_t *avr)
{
    reset_at = avr->cycle;
}

const crossbar_statistics_t *crossbar_statistics(void)
{
    return &statistics;
}
