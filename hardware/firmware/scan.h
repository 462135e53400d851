// Scans of the crossbar, paced by a timer, converted and stored by interrupts.
#ifndef SCAN_H
#define SCAN_H

#include <stdbool.h>
#include <stdint.h>

#include "settings.h"

typedef struct {
    uint32_t device_us;  // when it was due [us], modulo 2^32
    bool is_saturated;   // some count is 0 or full scale
    uint8_t overruns;    // scans skipped until it began, at most 255
    uint16_t counts[CROSSINGS];
} scan_t;

// Start scanning, `rate_hz` times a second; 1 to MAX_RATE.
void scan_init(uint16_t rate_hz);

// Another rate, from the next scan but one on.
void scan_set_rate(uint16_t rate_hz);

// The oldest finished scan, or NULL; it stays as it is until `scan_release`.
const scan_t *scan_finished(void);
void scan_release(void);

#endif
