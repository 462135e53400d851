// TriPillar's board: scans the crossbar and sends a frame a scan; docs/frames.md says what goes over the wire.
//
// Interrupts do what has to be in time: the timer starts scans, the converter fills them, the serial port sends and
// receives. The loop below does what may wait: it encodes finished scans and answers the host. While frame k is
// encoded and sent, scan k+1 runs.
//
// Nothing here depends on how the board was powered up: every register used is written. A brown-out detector
// (the boards' boot loaders set 2.7 V) resets the board cleanly; the host sees the sequence start again.

#include <avr/interrupt.h>
#include <avr/sleep.h>

#include "commands.h"
#include "frame.h"
#include "scan.h"
#include "settings.h"
#include "uart.h"

static uint8_t wire[FRAME_DATA_WIRE_SIZE(CROSSINGS)];
_Static_assert(sizeof wire >= FRAME_INFO_WIRE_SIZE, "the smallest array's frame is longer than INFO");

static uint16_t rate_hz = RATE;
static uint8_t infos_owed;

static void send_scan(const scan_t *scan)
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
    uart_send(wire, frame_data(wire, &header, scan->counts));
}

static void send_info(void)
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
    };
    uart_send(wire, frame_info(wire, &info));
}

static void listen(void)
{
    static commands_t commands;
    while (uart_has_received()) {
        command_t command = commands_take(&commands, uart_take());
        if (command == COMMAND_NONE)
            continue;
        if (command == COMMAND_RATE && commands.rate_hz >= 1 && commands.rate_hz <= MAX_RATE) {
            rate_hz = commands.rate_hz;
            scan_set_rate(rate_hz);
        }
        if (infos_owed < 255)
            infos_owed++;
    }
}

// Sleep until the next interrupt, unless there is something to do already.
static void rest(void)
{
    cli();
    if (!uart_has_received() && (uart_is_sending() || (!scan_finished() && !infos_owed))) {
        sleep_enable();
        sei();  // takes effect after the next instruction, so no interrupt slips in between
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

int main(void)
{
    set_sleep_mode(SLEEP_MODE_IDLE);
    uart_init();
    scan_init(rate_hz);
    wire[0] = 0;  // a delimiter: ends what the reset, or a boot loader, left on the line
    uart_send(wire, 1);
    sei();
    uint8_t is_infos_turn = 0;  // data and INFO frames take turns where both wait, so that neither starves
    for (;;) {
        listen();
        if (!uart_is_sending()) {
            const scan_t *scan = scan_finished();
            if (infos_owed && (is_infos_turn || !scan)) {
                send_info();
                infos_owed--;
                is_infos_turn = 0;
            } else if (scan) {
                send_scan(scan);
                scan_release();
                is_infos_turn = 1;
            }
        }
        rest();
    }
}
