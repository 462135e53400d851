// Resets a board that has stopped sending scans.
#ifndef WATCHDOG_H
#define WATCHDOG_H

#include <stdint.h>

// The board restarts after 2 s (the chip's own oscillator, 10 %) without `watchdog_feed`.
void watchdog_start(void);
void watchdog_feed(void);

// Why the board started: the chip's MCUSR, bit 0 power, 1 reset button or port opened, 2 brown-out, 3 watchdog; 0 where
// a boot loader has cleared it.
uint8_t watchdog_reset_cause(void);

#endif
