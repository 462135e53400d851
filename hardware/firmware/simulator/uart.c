// SPDX-License-Identifier: GPL-3.0-or-later
// simavr takes 11 bits for a byte, counting a parity bit that is not there; the wire takes 10. At 1 Mbaud a frame of
// 232 bytes so leaves in 2.55 ms instead of 2.32, both well within the 6.67 ms of 150 Hz. The board's clock is its
// timer, so neither scans nor device_us notice; bytes only arrive up to 0.23 ms later.

#include "uart.h"

#include <simavr/avr_uart.h>
#include <simavr/sim_io.h>
#include <string.h>

#include "options.h"
#include "port.h"

static avr_uart_t *uart;
static uint8_t from_board[4096];  // flushed every ms, in which at most 200 bytes come
static size_t n_from_board;
static uint8_t to_board[256];
static size_t n_to_board, n_fed;
static bool is_feeding;
static unsigned long damage_every;
static uart_statistics_t statistics;

static void on_sent(avr_irq_t *irq, uint32_t byte, void *unused)
{
    (void)irq, (void)unused;
    if (n_from_board < sizeof from_board)
        from_board[n_from_board++] = (uint8_t)byte;
    else
        statistics.dropped++;
}

// A real serial port holds two bytes and a third in its shift register, simavr's 64. What comes then is lost, and the
// next byte that is not says so in the status register. More are let in here: simavr hands over one byte a byte time at
// most, so what once waits goes on waiting until a burst ends, where a real port's interrupt catches up at once.
#define HELD 32
#define PLACES (sizeof ((avr_uart_t *)0)->input.buffer / sizeof *((avr_uart_t *)0)->input.buffer)
static bool is_behind_gap[PLACES];
static bool is_gap;
static avr_io_read_t read_status;

static uint8_t on_status_read(avr_t *avr, avr_io_addr_t address, void *unused)
{
    uint8_t overrun = (uint8_t)(1 << uart->dor.bit), status = read_status(avr, address, unused) & (uint8_t)~overrun;
    return is_behind_gap[uart->input.read] ? status | overrun : status;
}

static void receive(uint32_t value)
{
    if ((uart->input.write + PLACES - uart->input.read) % PLACES == HELD) {
        statistics.overrun++;
        is_gap = true;
        return;
    }
    avr_regbit_clear(uart->io.avr, uart->dor);  // simavr takes nothing while it is set
    is_behind_gap[uart->input.write] = is_gap;
    is_gap = false;
    avr_raise_irq(uart->io.irq + UART_IRQ_INPUT, value);
}

static avr_cycle_count_t feed(avr_t *avr, avr_cycle_count_t when, void *unused)
{
    (void)avr, (void)unused;
    if (n_fed == n_to_board) {
        is_feeding = false;
        return 0;
    }
    uint32_t value = to_board[n_fed++];
    statistics.received++;
    if (damage_every && statistics.received % damage_every == 0)
        value |= UART_INPUT_FE;
    receive(value);
    return when + uart->cycles_per_byte;
}

void uart_connect(avr_t *avr, unsigned long damage)
{
    damage_every = damage;
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (strcmp(io->kind, "uart") == 0 && ((avr_uart_t *)io)->name == '0')
            uart = (avr_uart_t *)io;  // an avr_io_t is the first member of each module
    if (!uart)
        fail("this MCU has no serial port 0: take atmega328p or atmega2560.");
    uart->flags &= ~(uint32_t)(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_irq_register_notify(uart->io.irq + UART_IRQ_OUTPUT, on_sent, NULL);
    avr_io_addr_t status = AVR_DATA_TO_IO(uart->r_ucsra);
    read_status = avr->io[status].r.c;
    avr->io[status].r.c = on_status_read;
}

void uart_reset(void)
{
    n_to_board = n_fed = 0;
    is_feeding = is_gap = false;
}

void uart_flush(bool waits, const volatile int *stop)
{
    size_t n_written = port_write(from_board, n_from_board);
    while (waits && n_written < n_from_board && !*stop) {
        port_wait_for_room(100);
        n_written += port_write(from_board + n_written, n_from_board - n_written);
    }
    statistics.sent += n_written;
    if (!waits)
        statistics.dropped += n_from_board - n_written;  // as on a real wire that nobody listens to
    n_from_board = 0;
}

void uart_listen(void)
{
    if (is_feeding)
        return;
    n_fed = 0;
    n_to_board = port_read(to_board, sizeof to_board);
    if (n_to_board > 0) {
        is_feeding = true;
        avr_cycle_timer_register(uart->io.avr, uart->cycles_per_byte, feed, NULL);
    }
}

const uart_statistics_t *uart_statistics(void)
{
    return &statistics;
}
