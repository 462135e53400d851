// Frames as docs/frames.md states them. Portable C: the same file serves the board and, compiled natively, its tests.
#ifndef FRAME_H
#define FRAME_H

#include <stdint.h>

#define FRAME_PROTOCOL 1

// Bytes on the wire: CRC and the bytes before it, COBS' one byte for each 254 begun, the delimiter.
#define FRAME_WIRE_SIZE(packed) ((packed) + ((packed) + 253) / 254 + 1)
#define FRAME_DATA_WIRE_SIZE(count) FRAME_WIRE_SIZE(12 + 2 * (count) + 2)
#define FRAME_INFO_WIRE_SIZE(n_layout) FRAME_WIRE_SIZE(23 + (n_layout))
#define FRAME_ERRORS_WIRE_SIZE FRAME_WIRE_SIZE(6)

typedef struct {
    uint8_t flags;
    uint16_t sequence;
    uint32_t device_us;
    uint16_t count;
    uint8_t bits;
    uint8_t overruns;
} frame_header_t;

typedef struct {
    uint8_t rows, cols, bits, scan_mode;
    uint8_t firmware[3];
    uint16_t rate_hz;
    uint32_t serial, sense_ohm;
    uint16_t vref_mv;
    const char *layout;  // in flash; empty: three pillars a unit, as the paper has them
} frame_info_t;

typedef struct {
    uint8_t reset_cause, bad_bytes, losses;
} frame_errors_t;

// CRC-16/IBM-3740 after one more byte; it starts at 0xFFFF.
uint16_t frame_crc(uint16_t crc, uint8_t byte);

// Write a whole frame, delimiter included, to `wire`; returns its size, the macros above or, past 254 bytes,
// up to that many blocks less. A size has 16 bits: at most 32000 counts.
uint16_t frame_data(uint8_t *wire, const frame_header_t *header, const uint16_t *counts);
uint16_t frame_info(uint8_t *wire, const frame_info_t *info);
uint16_t frame_errors(uint8_t *wire, const frame_errors_t *errors);

#endif
