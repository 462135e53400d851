// TriPillar's board: scans the crossbar and sends a frame a scan; docs/frames.md says what goes over the wire.
//
// Interrupts do what has to be in time: the timer starts scans, the converter fills them, the serial port sends and
// receives. The loop below does what may wait: it encodes finished scans and answers the host. So three frames are on
// their way at a time: one is scanned, one encoded, one sent; of sensors whose frames leave no memory for that, two.
//
// Nothing here depends on how the board was powered up: every register used is written. A brown-out detector
// (the boards' boot loaders set 2.7 V) resets the board cleanly; the host sees the sequence start again.

#include <avr/interrupt.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>

#include "commands.h"
#include "frame.h"
#include "scan.h"
#include "settings.h"
#include "uart.h"
#include "watchdog.h"

static const char layout[] PROGMEM = LAYOUT;  // stays in flash: it may be long

// Two frames as they go over the wire: one is sent while the next is encoded. Where memory is short, one: the next is
// encoded once it has gone, which at 1 Mbaud still takes less time than a scan.
#define LARGER(a, b) ((a) > (b) ? (a) : (b))
#define WIRE_SIZE (int32_t) LARGER(FRAME_DATA_WIRE_SIZE((uint32_t)CROSSINGS), FRAME_INFO_WIRE_SIZE(sizeof layout - 1))
#define FREE_SIZE (RAMEND - RAMSTART + 1 - 2 * (int32_t)sizeof(scan_t) - 390)  // without the stack and all others'
#define WIRES (2 * WIRE_SIZE > FREE_SIZE ? 1 : 2)
_Static_assert(WIRE_SIZE <= FREE_SIZE, "this sensor has more pillars than the RAM of this board holds frames of: "
               "build for a larger one alone, BOARD=atmega2560");
static uint8_t wires[WIRES][WIRE_SIZE];
static uint8_t free_wire;   // which of the two is not being sent
static uint16_t n_encoded;  // bytes in it; 0: it is free

#define HEARD_AT_ONCE 16  // bytes

static uint16_t rate_hz = RATE;
static uint8_t infos_owed, errors_owed;

static void encode_scan(const scan_t *scan)
{
    static uint16_t sequence;
    frame_header_t header = {
        .flags = (uint8_t)(scan->is_saturated | SCAN_MODE << 1),
        .sequence = sequence++,
        .device_us = scan->device_us,
        .count = CROSSINGS,
        .bits = BITS,
        .overruns = scan->overruns,
    };
    n_encoded = frame_data(wires[free_wire], &header, scan->counts);
    watchdog_feed();  // timer, converter, serial port and this loop have all done their part since the scan before
}

static void encode_info(void)
{
    frame_info_t info = {
        .rows = ROWS,
        .cols = COLS,
        .bits = BITS,
        .scan_mode = SCAN_MODE,
        .firmware = FIRMWARE,
        .rate_hz = rate_hz,
        .serial = SERIAL,
        .sense_ohm = SENSE_OHM,
        .vref_mv = VREF_MV,
        .layout = layout,
    };
    n_encoded = frame_info(wires[free_wire], &info);
}

static void encode_errors(void)
{
    frame_errors_t errors = {
        .reset_cause = watchdog_reset_cause(),
        .bad_bytes = uart_bad_bytes(),
        .losses = uart_losses(),
    };
    n_encoded = frame_errors(wires[free_wire], &errors);
}

static void owe(uint8_t *answers)
{
    if (*answers < 255)
        ++*answers;
}

// Only so many bytes at a time: a host that never stops talking does not keep the board from sending.
static void listen(void)
{
    static commands_t commands;
    for (uint8_t n = 0; n < HEARD_AT_ONCE && uart_has_received(); n++) {
        command_t command = commands_take(&commands, uart_take());
        if (command == COMMAND_NONE)
            continue;
        if (command == COMMAND_RATE && commands.rate_hz >= 1 && commands.rate_hz <= MAX_RATE) {
            rate_hz = commands.rate_hz;
            scan_set_rate(rate_hz);
        }
        owe(command == COMMAND_ERRORS ? &errors_owed : &infos_owed);
    }
}

// Encode the next frame, if there is one. Data and answers take turns where both wait, so that neither starves.
static void encode_next(void)
{
    static uint8_t is_answers_turn;
    const scan_t *scan = scan_finished();
    if (scan && !(is_answers_turn && (infos_owed || errors_owed))) {
        encode_scan(scan);
        scan_release();
        is_answers_turn = 1;
    } else if (errors_owed) {
        encode_errors();
        errors_owed--;
        is_answers_turn = 0;
    } else if (infos_owed) {
        encode_info();
        infos_owed--;
        is_answers_turn = 0;
    }
}

static void send_encoded(void)
{
    uart_send(wires[free_wire], n_encoded);
    free_wire ^= WIRES - 1;
    n_encoded = 0;
}

static uint8_t may_encode(void)
{
    return !n_encoded && (WIRES == 2 || !uart_is_sending());
}

static uint8_t has_work(void)
{
    return uart_has_received() || (n_encoded && !uart_is_sending()) ||
           (may_encode() && (infos_owed || errors_owed || scan_finished()));
}

// Sleep until the next interrupt, unless there is something to do already.
static void rest(void)
{
    cli();
    if (!has_work()) {
        sleep_enable();
        sei();  // takes effect after the next instruction, so no interrupt slips in between
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

int main(void)
{
    watchdog_start();
    set_sleep_mode(SLEEP_MODE_IDLE);
    uart_init();
    scan_init(rate_hz);
    wires[free_wire][0] = 0;  // a delimiter: ends what the reset, or a boot loader, left on the line
    n_encoded = 1;
    sei();
    for (;;) {
        listen();
        if (may_encode())
            encode_next();
        if (n_encoded && !uart_is_sending())
            send_encoded();
        rest();
    }
}
