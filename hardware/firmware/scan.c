#include "scan.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stddef.h>
#include <util/atomic.h>
#include <util/delay.h>

#include "board.h"

#define FULL_SCALE ((1 << BITS) - 1)
#define TICKS_PER_US 2  // timer 1 counts F_CPU / 8
#define LONG_WAIT_US 16384U
_Static_assert(F_CPU == 16000000UL, "prescalers of timer and converter are for 16 MHz");

#define ADC_OFF_AFTER_THIS (1 << ADEN | 1 << ADIE | 1 << ADPS2 | 1 << ADPS1)  // clock F_CPU / 64
#define ADC_RUN (ADC_OFF_AFTER_THIS | 1 << ADATE | 1 << ADSC)

// Two scans: one is filled while the other waits to be encoded.
static scan_t scans[2];
static volatile bool is_finished[2];
static uint8_t filling;   // which of the two; used by interrupts only
static uint8_t encoding;  // likewise; used by the main program only

// ---- when -------------------------------------------------------------------------------------------------

static uint16_t rate;           // [Hz]
static uint32_t period_us;      // whole microseconds from scan to scan
static uint16_t period_rest;    // and what is missing: period_rest / rate microseconds
static uint16_t carried_rest;   // of all periods so far, so that rates are exact on average
static uint32_t due_us;         // the board's clock when the next scan is due
static uint32_t wait_us;        // from the next timer interrupt to then

static void wait(void)
{
    // A timer of 16 bits reaches 32.7 ms. What is longer is cut up, and in such a way that no piece gets short:
    // a moment set less than an interrupt's duration ahead would be missed and come a whole turn later.
    uint16_t step_us = wait_us < 2 * (uint32_t)LONG_WAIT_US ? (uint16_t)wait_us : LONG_WAIT_US;
    wait_us -= step_us;
    OCR1A += TICKS_PER_US * step_us;
}

static void schedule_next(void)
{
    wait_us = period_us;
    carried_rest += period_rest;
    if (carried_rest >= rate) {
        carried_rest -= rate;
        wait_us++;
    }
    due_us += wait_us;
    wait();
}

void scan_set_rate(uint16_t rate_hz)
{
    // A division takes 40 us, which the converter's interrupt cannot wait. Volatile, or the compiler moves it into the
    // locked block.
    volatile uint32_t new_period_us = 1000000UL / rate_hz;
    volatile uint16_t new_rest = (uint16_t)(1000000UL % rate_hz);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        rate = rate_hz;
        period_us = new_period_us;
        period_rest = new_rest;
        carried_rest = 0;
    }
}

// ---- where ------------------------------------------------------------------------------------------------

static const uint16_t populated[UNIT_ROWS] = UNIT_CROSSINGS;

static uint8_t row, column;      // wires of the address on the pins
static uint8_t unit_row;         // the row wire within its unit
static uint16_t left;            // crossings from this column wire on, to the end of its unit; bit 0 is the column's
static uint8_t left_of_columns;  // column wires from this one on, to the end of its unit

static void enter_unit(void)
{
    left = populated[unit_row];
    left_of_columns = UNIT_COLUMNS;
}

static void address_next(void)
{
    do {  // to the next crossing that is populated
        column++;
        left >>= 1;
        if (--left_of_columns == 0) {
            if (column == COLUMN_WIRES) {
                column = 0;
                row = row + 1 < ROW_WIRES ? row + 1 : 0;
                unit_row = unit_row + 1 < UNIT_ROWS ? unit_row + 1 : 0;
            }
            enter_unit();
        }
    } while (!(left & 1));
    board_set_address(row, column);
}

static void address_first(void)
{
    row = ROW_WIRES - 1;  // from behind the last crossing
    unit_row = UNIT_ROWS - 1;
    column = COLUMN_WIRES - 1;
    left_of_columns = 1;
    address_next();
}

// ---- scan -------------------------------------------------------------------------------------------------

// Conversions follow one another without a pause, 52 us each, and the converter samples its input 1.5 of its
// clocks (6 us) after each starts. So the address of the next crossing goes out as soon as the running conversion
// has sampled, and the circuit has the rest of that conversion plus the next one's 6 us to settle: 41 us, and no less
// than 30 when other interrupts come first. The simulated board measures it (min_settle_us).
//
//     conversion       |-s---- k -------------|-s---- k+1 -----------|-s-
//     interrupt                                read k, wait, k+2 out
//     address on pins  ---- k+1 ---------------------|-- k+2 ------------

static volatile bool is_scanning;
static uint8_t overruns;
static uint16_t n_left;       // counts to come in this scan
static uint16_t *next_count;  // where the next one goes
static bool is_saturated;

ISR(TIMER1_COMPA_vect)
{
    if (wait_us > 0) {
        wait();
        return;
    }
    uint32_t now_us = due_us;
    schedule_next();
    if (is_scanning || is_finished[filling]) {
        if (overruns < 255)
            overruns++;
        return;
    }
    ADCSRA = ADC_RUN;  // crossing 0 has been addressed since the last scan ended
    is_scanning = true;
    is_saturated = false;
    n_left = CROSSINGS;
    next_count = scans[filling].counts;
    scans[filling].device_us = now_us;
    scans[filling].overruns = overruns;
    _delay_us(3 * ADC_CLOCK_US);  // up to one clock until it starts, 1.5 until it has sampled
    address_next();
}

static void finish_scan(void)
{
    scans[filling].is_saturated = is_saturated;
    is_finished[filling] = true;
    filling ^= 1;
    is_scanning = false;
}

ISR(ADC_vect)
{
    uint16_t count = ADC;
    *next_count++ = count;
    if (count == 0 || count == FULL_SCALE)
        is_saturated = true;
    n_left--;
    if (n_left == 0) {
        finish_scan();
        return;
    }
    if (n_left == 1)
        ADCSRA = ADC_OFF_AFTER_THIS;  // the last conversion is running: none is to follow
    // The running conversion samples 1.5 clocks after its start. Waiting as long from here is on the safe side:
    // entering this interrupt has already taken 3 us.
    _delay_us(1.5 * ADC_CLOCK_US);
    if (n_left == 1)
        address_first();  // for the next scan
    else
        address_next();
}

void scan_init(uint16_t rate_hz)
{
    board_init();
    address_first();

    DIDR0 = 1 << ANALOG_CHANNEL;             // no digital input on the analogue pin: less noise
    ADMUX = 1 << REFS0 | ANALOG_CHANNEL;     // reference AVcc: it feeds the crossbar too, so its drift cancels
    ADCSRB = 0;                              // free running
    ADCSRA = 1 << ADEN | 1 << ADSC | 1 << ADPS2 | 1 << ADPS1;
    while (ADCSRA & 1 << ADSC)
        ;  // the first conversion takes 25 clocks and is the least exact: drop it
    (void)ADC;
    ADCSRA = ADC_OFF_AFTER_THIS | 1 << ADIF;

    TCCR1A = 0;  // a boot loader may have left the timer in use
    TCCR1B = 0;
    TCNT1 = 0;
    OCR1A = 0;
    scan_set_rate(rate_hz);
    schedule_next();
    TIFR1 = 1 << OCF1A;
    TIMSK1 = 1 << OCIE1A;
    TCCR1B = 1 << CS11;  // the board's clock starts
}

const scan_t *scan_finished(void)
{
    return is_finished[encoding] ? &scans[encoding] : NULL;
}

void scan_release(void)
{
    is_finished[encoding] = false;
    encoding ^= 1;
}
