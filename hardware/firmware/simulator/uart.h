// SPDX-License-Identifier: GPL-3.0-or-later
// The wire between the simulated serial port and the pseudo terminal.
#ifndef UART_H
#define UART_H

#include <simavr/sim_avr.h>
#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint64_t sent, dropped, received;  // bytes, seen from the board
    uint64_t overrun;                  // of those received: lost, since the board did not read in time
} uart_statistics_t;

// Every so manieth byte from the host arrives with a wrong stop bit; 0: none.
void uart_connect(avr_t *avr, unsigned long damage);

// To be told after each avr_reset: what was on its way to the board is lost.
void uart_reset(void);

// Hand over what the board has sent: now, as far as there is room, or, if `waits`, all of it.
// As soon as `*stop` is set it waits no longer, and what is left counts as never sent.
void uart_flush(bool waits, const volatile int *stop);

// Let the board receive what the host has sent, one byte time a byte.
void uart_listen(void);

const uart_statistics_t *uart_statistics(void);

#endif
