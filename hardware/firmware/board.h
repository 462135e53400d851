// Which pin does what, for each board. docs/board.md has the same as tables for the soldering iron.
#ifndef BOARD_H
#define BOARD_H

#include <avr/io.h>

#if defined(__AVR_ATmega328P__)  // Arduino Uno, Nano

#define ROW_PORT PORTB  // PB0 to PB3: D8 to D11
#define ROW_DDR DDRB
#define ROW_SHIFT 0
#define COLUMN_PORT PORTD  // PD4 to PD7: D4 to D7; PD0 and PD1 are the serial port
#define COLUMN_DDR DDRD
#define COLUMN_SHIFT 4

#define UART_RX_vect USART_RX_vect
#define UART_UDRE_vect USART_UDRE_vect

#elif defined(__AVR_ATmega2560__)  // Arduino Mega

#define ROW_PORT PORTA  // PA0 to PA3: D22 to D25
#define ROW_DDR DDRA
#define ROW_SHIFT 0
#define COLUMN_PORT PORTC  // PC0 to PC3: D37 to D34, in falling order
#define COLUMN_DDR DDRC
#define COLUMN_SHIFT 0

#define UART_RX_vect USART0_RX_vect
#define UART_UDRE_vect USART0_UDRE_vect

#else
#error "no pins for this microcontroller: add them here, for atmega328p and atmega2560 they are known"
#endif

#define ANALOG_CHANNEL 0  // A0 on both

#define ROW_MASK (0x0F << ROW_SHIFT)
#define COLUMN_MASK (0x0F << COLUMN_SHIFT)

static inline void board_set_address(uint8_t row, uint8_t column)
{
    ROW_PORT = (ROW_PORT & (uint8_t)~ROW_MASK) | (uint8_t)(row << ROW_SHIFT);
    COLUMN_PORT = (COLUMN_PORT & (uint8_t)~COLUMN_MASK) | (uint8_t)(column << COLUMN_SHIFT);
}

static inline void board_init(void)
{
    ROW_DDR |= ROW_MASK;  // at reset all pins are inputs: the switches' address floats until here
    COLUMN_DDR |= COLUMN_MASK;
    board_set_address(0, 0);
}

#endif
