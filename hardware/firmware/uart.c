#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "board.h"
#include "settings.h"

#define DIVIDER ((F_CPU + 4UL * BAUD) / (8UL * BAUD))  // of the clock, rounded; double speed: 8 clocks a bit
_Static_assert(DIVIDER >= 1 && DIVIDER <= 4096, "BAUD is out of the serial port's reach");
_Static_assert(8UL * BAUD * DIVIDER >= F_CPU / 100 * 98 && 8UL * BAUD * DIVIDER <= F_CPU / 100 * 102,
               "BAUD is off by more than 2 %: take 1000000, 500000, 250000 or 38400");

#define RING 64       // bytes received and not yet taken; a power of 2
#define DAMAGED 0xFF  // no part of any command

static const uint8_t *next, *end;  // of the bytes being sent; the interrupt's while `uart_is_sending`

static volatile uint8_t ring[RING];
static volatile uint8_t head;  // bytes ever received, modulo 256: written by the interrupt
static volatile uint8_t tail;  // bytes ever taken, modulo 256: written by `uart_take`
static volatile uint8_t bad_bytes, losses;

void uart_init(void)
{
    UCSR0A = 1 << U2X0;  // before the divider: simavr reads it when the divider is written
    UBRR0H = (uint8_t)((DIVIDER - 1) >> 8);
    UBRR0L = (uint8_t)(DIVIDER - 1);
    UCSR0C = 1 << UCSZ01 | 1 << UCSZ00;
    UCSR0B = 1 << RXCIE0 | 1 << RXEN0 | 1 << TXEN0;
}

bool uart_is_sending(void)
{
    return UCSR0B & 1 << UDRIE0;  // switched off with the last byte; one byte to read, so no race
}

void uart_send(const uint8_t *bytes, uint16_t size)
{
    next = bytes;
    end = bytes + size;
    __asm__ volatile("" ::: "memory");  // the above is written before the interrupt takes it from here
    UCSR0B |= 1 << UDRIE0;
}

// With the port busy both ways these two would take all of the CPU, and they go before the converter's interrupt, which
// must not wait. So each switches itself off and lets the others in: bytes may wait, there is room for two in the port.

ISR(UART_UDRE_vect)
{
    UCSR0B &= (uint8_t)~(1 << UDRIE0);
    sei();
    const uint8_t *byte = next;
    UDR0 = *byte++;
    next = byte;
    bool is_last = byte == end;
    cli();
    if (!is_last)
        UCSR0B |= 1 << UDRIE0;
}

static void count(volatile uint8_t *errors)
{
    if (*errors < 255)
        ++*errors;
}

ISR(UART_RX_vect)
{
    UCSR0B &= (uint8_t)~(1 << RXCIE0);
    sei();
    uint8_t place = head;
    if ((uint8_t)(place - tail) == RING)
        return;  // switched off until `uart_take` has made room; a flood is lost in the port and costs no more time
    uint8_t status = UCSR0A;  // goes with the byte that is read next
    uint8_t byte = UDR0;
    if (status & 1 << FE0)
        count(&bad_bytes);
    if (status & 1 << DOR0)
        count(&losses);
    ring[place % RING] = status & (1 << FE0 | 1 << DOR0) ? DAMAGED : byte;
    head = place + 1;
    cli();
    UCSR0B |= 1 << RXCIE0;
}

bool uart_has_received(void)
{
    return head != tail;
}

uint8_t uart_take(void)
{
    uint8_t byte = ring[tail % RING];
    tail++;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        UCSR0B |= 1 << RXCIE0;
    }
    return byte;
}

uint8_t uart_bad_bytes(void)
{
    return bad_bytes;
}

uint8_t uart_losses(void)
{
    return losses;
}
