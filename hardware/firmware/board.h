// Which pin does what, for each board. docs/board.md has the same as tables for the soldering iron.
#ifndef BOARD_H
#define BOARD_H

#include <avr/io.h>

#include "settings.h"

#if defined(__AVR_ATmega328P__)  // Arduino Uno, Nano

#define MAX_WIRES 64
#define ROW_PORT PORTB  // bits 0 to 5 of the number: PB0 to PB5, D8 to D13
#define ROW_DDR DDRB
#define ROW_PINS(number) (number)
#define COLUMN_PORT PORTD  // bits 0 to 3: PD4 to PD7, D4 to D7; then PD3 and PD2; PD0 and PD1 are the serial port
#define COLUMN_DDR DDRD
#define COLUMN_PINS(number) ((number) << 4 | ((number) >> 4 & 1) << 3 | ((number) >> 5 & 1) << 2)

#define UART_RX_vect USART_RX_vect
#define UART_UDRE_vect USART_UDRE_vect

#elif defined(__AVR_ATmega2560__)  // Arduino Mega

#define MAX_WIRES 128
#define ROW_PORT PORTA  // PA0 to PA6: D22 to D28
#define ROW_DDR DDRA
#define ROW_PINS(number) (number)
#define COLUMN_PORT PORTC  // PC0 to PC6: D37 to D31, in falling order
#define COLUMN_DDR DDRC
#define COLUMN_PINS(number) (number)

#define UART_RX_vect USART0_RX_vect
#define UART_UDRE_vect USART0_UDRE_vect

#else
#error "no pins for this microcontroller: add them here, for atmega328p and atmega2560 they are known"
#endif

#define ANALOG_CHANNEL 0  // A0 on both

_Static_assert(ROW_WIRES <= MAX_WIRES && COLUMN_WIRES <= MAX_WIRES,
               "the pins of an atmega328p number 64 row and 64 column wires, those of an atmega2560 128: "
               "this sensor has more");

// Four bits number up to 16 wires; each doubling takes one pin more.
#define HIGHEST(wires) ((wires) > 64 ? 0x7F : (wires) > 32 ? 0x3F : (wires) > 16 ? 0x1F : 0x0F)
#define ROW_MASK (uint8_t)ROW_PINS(HIGHEST(ROW_WIRES))
#define COLUMN_MASK (uint8_t)COLUMN_PINS(HIGHEST(COLUMN_WIRES))

static inline void board_set_address(uint8_t row, uint8_t column)
{
    ROW_PORT = (ROW_PORT & (uint8_t)~ROW_MASK) | (uint8_t)ROW_PINS(row);
    COLUMN_PORT = (COLUMN_PORT & (uint8_t)~COLUMN_MASK) | (uint8_t)COLUMN_PINS(column);
}

static inline void board_init(void)
{
    ROW_DDR |= ROW_MASK;  // at reset all pins are inputs: the switches' address floats until here
    COLUMN_DDR |= COLUMN_MASK;
    board_set_address(0, 0);
}

#endif
