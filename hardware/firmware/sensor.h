// 6 x 6 units of song2018; 'tripillar export --to header' wrote it.
#ifndef ROWS
#define ROWS 6  // units along y
#endif
#ifndef COLS
#define COLS 6  // units along x
#endif
#define UNIT_ROWS 2  // row wires of a unit
#define UNIT_COLUMNS 2  // column wires of a unit
#define UNIT_PILLARS 3
#define UNIT_CROSSINGS {0x3, 0x1}  // of each row wire: bit k is set where a pillar joins column wire k
#define LAYOUT ""  // as INFO states it
