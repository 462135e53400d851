// SPDX-License-Identifier: GPL-3.0-or-later
// The table file: what an ideal converter reads at each crossing, over time.
//
// Little-endian: "TPTB", then seven u32: version (1), row wires, column wires, steps, step_us, full scale (1023),
// flags (bit 0: start again after the last step, else hold it); then steps x row wires x column wires u16 counts.
#ifndef TABLE_H
#define TABLE_H

#include <stdbool.h>
#include <stdint.h>

#define TABLE_FULL_SCALE 1023
#define TABLE_EMPTY 0xFFFF  // where no pillar joins the wires

typedef struct {
    uint32_t rows, columns;  // wires
    uint32_t steps;
    uint32_t step_us;
    bool loops;
    const uint16_t *counts;  // mapped: what another program writes there while we run, holds from then on
} table_t;

table_t table_open(const char *path);

// The count of a crossing at a device time; 0 to TABLE_FULL_SCALE, or TABLE_EMPTY.
uint16_t table_count(const table_t *table, uint64_t device_us, uint32_t row, uint32_t column);

#endif
