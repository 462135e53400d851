// SPDX-License-Identifier: GPL-3.0-or-later
#include "table.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "options.h"

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the table is read as it lies in the file: swap its bytes here for this machine"
#endif

typedef struct {
    char magic[4];
    uint32_t version, rows, columns, steps, step_us, full_scale, flags;
} header_t;
_Static_assert(sizeof(header_t) == 32, "as in the file");

static const header_t *mapped(const char *path, uint64_t *size)
{
    int file = open(path, O_RDONLY | O_CLOEXEC);
    struct stat status;
    if (file < 0 || fstat(file, &status) < 0)
        fail("%s: %s: give a table file.", path, strerror(errno));
    if (!S_ISREG(status.st_mode) || (*size = (uint64_t)status.st_size) < sizeof(header_t))
        fail("%s: no table file: it has no header of 32 bytes.", path);
    void *data = mmap(NULL, *size, PROT_READ, MAP_SHARED, file, 0);
    if (data == MAP_FAILED)
        fail("%s: %s: the table cannot be mapped.", path, strerror(errno));
    close(file);
    return data;
}

table_t table_open(const char *path)
{
    uint64_t size = 0;
    const header_t *header = mapped(path, &size);
    if (memcmp(header->magic, "TPTB", 4) != 0)
        fail("%s: no table file: it does not start with TPTB.", path);
    if (header->version != 1)
        fail("%s: table version %u, this program reads 1.", path, header->version);
    if (header->rows < 1 || header->rows > 128 || header->columns < 1 || header->columns > 128)
        fail("%s: %u x %u wires, expected 1 to 128 each.", path, header->rows, header->columns);
    if (header->steps < 1 || header->step_us < 1)
        fail("%s: %u steps of %u us, expected at least 1 of 1.", path, header->steps, header->step_us);
    if (header->full_scale != TABLE_FULL_SCALE)
        fail("%s: full scale is %u, the board's converter has %d.", path, header->full_scale, TABLE_FULL_SCALE);
    uint64_t needed = sizeof *header + (uint64_t)header->steps * header->rows * header->columns * 2;
    if (size < needed)
        fail("%s: %llu bytes, its header announces %llu: write it again.", path, (unsigned long long)size,
             (unsigned long long)needed);
    return (table_t){
        .rows = header->rows,
        .columns = header->columns,
        .steps = header->steps,
        .step_us = header->step_us,
        .loops = header->flags & 1,
        .counts = (const uint16_t *)(header + 1),
    };
}

uint16_t table_count(const table_t *table, uint64_t device_us, uint32_t row, uint32_t column)
{
    uint64_t step = device_us / table->step_us;
    if (step >= table->steps)
        step = table->loops ? step % table->steps : table->steps - 1;
    uint16_t count = table->counts[(step * table->rows + row) * table->columns + column];
    return count > TABLE_FULL_SCALE && count != TABLE_EMPTY ? TABLE_FULL_SCALE : count;
}
