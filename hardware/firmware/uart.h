// The serial port: 8 data bits, no parity, 1 stop bit; sent and received by interrupts.
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

void uart_init(void);

bool uart_is_sending(void);

// Send `size` > 0 bytes; `bytes` must keep them while `uart_is_sending`, and nothing else may be on its way.
void uart_send(const uint8_t *bytes, uint16_t size);

bool uart_has_received(void);

// The oldest byte received; only if `uart_has_received`. 0xFF stands for a damaged one, and for one before which others
// were lost: so a command with a hole in it is none.
uint8_t uart_take(void);

// Since the start, 255 standing for more: bytes with a wrong stop bit, and how often one or more bytes were lost.
uint8_t uart_bad_bytes(void);
uint8_t uart_losses(void);

#endif
