// What a build may choose; each of these can be given to make, as in `make SERIAL=17 SCAN_MODE=0`. What sensor it reads
// says the header that make's SENSOR names, which every file includes.
#ifndef SETTINGS_H
#define SETTINGS_H

#include <stdint.h>

#ifndef SCAN_MODE
#define SCAN_MODE 2  // 0 divider, 1 grounded, 2 zero-potential: which read-out circuit the board carries
#endif
#ifndef SENSE_OHM
#define SENSE_OHM 4700  // sense resistor, in zero-potential mode the amplifiers' feedback resistor
#endif
#ifndef VREF_MV
#define VREF_MV 5000  // AVcc, which is also what feeds the crossbar
#endif
#ifndef SERIAL
#define SERIAL 0  // the board's own number, 0: it has none
#endif
#ifndef RATE
#define RATE (MAX_RATE < 150 ? MAX_RATE : 150)  // scans a second after a reset [Hz]
#endif
#ifndef BAUD
#define BAUD 1000000
#endif

#define BITS 10  // of the ATmega's converter
#define FIRMWARE {1, 1, 0}
#define ROW_WIRES ((ROWS) * UNIT_ROWS)
#define COLUMN_WIRES ((COLS) * UNIT_COLUMNS)
#define CROSSINGS (UNIT_PILLARS * (ROWS) * (COLS))

// The converter, free running: 13 of its clocks a conversion, F_CPU / 64 = 250 kHz. The data sheet gives full
// accuracy up to 200 kHz and usable results to 1 MHz; at 250 kHz, 108 conversions leave 1 ms of 6.67 to spare.
#define ADC_CLOCK_US 4
#define CONVERSION_US (13 * ADC_CLOCK_US)
// A scan ends with the last conversion; the margin holds the wait for the first converter clock and the interrupts.
#define SCAN_US (CONVERSION_US * (uint32_t)CROSSINGS + 50)
#define MAX_RATE (1000000 / SCAN_US)

#define IS_WITHIN(value, low, high) ((int64_t)(value) >= (low) && (int64_t)(value) <= (high))
_Static_assert(IS_WITHIN(ROWS, 1, 128) && IS_WITHIN(COLS, 1, 128), "ROWS, COLS: at least 1, and their wires' numbers");
_Static_assert(IS_WITHIN(UNIT_COLUMNS, 1, 16), "UNIT_COLUMNS: 1 to 16, the bits of UNIT_CROSSINGS");
_Static_assert(IS_WITHIN(SCAN_MODE, 0, 3), "SCAN_MODE: 0 divider, 1 grounded, 2 zero-potential, 3 four-wire");
_Static_assert(IS_WITHIN(SENSE_OHM, 1, 0xFFFFFFFF), "SENSE_OHM: 1 to 4294967295");
_Static_assert(IS_WITHIN(VREF_MV, 1, 65535), "VREF_MV: 1 to 65535");
_Static_assert(IS_WITHIN(SERIAL, 0, 0xFFFFFFFF), "SERIAL: 0 to 4294967295");
_Static_assert(IS_WITHIN(RATE, 1, MAX_RATE), "RATE: 1 to what the scan time allows, 176 for 108 pillars, 88 for 216");

#endif
