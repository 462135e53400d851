#include "frame.h"

#ifdef __AVR__
#include <avr/pgmspace.h>
#else
#define pgm_read_byte(address) (*(address))
#endif

// A frame being written: each byte goes through CRC and COBS on its way to the wire, so no second buffer is needed.
typedef struct {
    uint8_t *next;   // where the next byte goes
    uint8_t *block;  // COBS: where the running block's length goes once it is known
    uint16_t crc;
} writer_t;

uint16_t frame_crc(uint16_t crc, uint8_t byte)
{
    // Eight steps of the polynomial x^16 + x^12 + x^5 + 1 at once: crc << 8 ^ x << 12 ^ x << 5 ^ x, written in single
    // bytes, which is what the ATmega has. No table, and half the time of the same in 16 bits.
    uint8_t x = (uint8_t)(crc >> 8) ^ byte;
    x ^= x >> 4;
    uint8_t high = (uint8_t)crc ^ (uint8_t)(x << 4) ^ (x >> 3);
    uint8_t low = x ^ (uint8_t)(x << 5);
    return (uint16_t)high << 8 | low;
}

static void open_block(writer_t *writer)
{
    writer->block = writer->next++;
}

static void close_block(writer_t *writer)
{
    *writer->block = (uint8_t)(writer->next - writer->block);
}

static void put_stuffed(writer_t *writer, uint8_t byte)
{
    if (writer->next - writer->block == 0xFF) {  // a full block stands for its 254 bytes and no zero
        close_block(writer);
        open_block(writer);
    }
    if (byte == 0) {  // any other block ends where a zero was
        close_block(writer);
        open_block(writer);
    } else {
        *writer->next++ = byte;
    }
}

static void put_u8(writer_t *writer, uint8_t value)
{
    writer->crc = frame_crc(writer->crc, value);
    put_stuffed(writer, value);
}

static void put_u16(writer_t *writer, uint16_t value)
{
    put_u8(writer, (uint8_t)value);
    put_u8(writer, (uint8_t)(value >> 8));
}

static void put_u32(writer_t *writer, uint32_t value)
{
    put_u16(writer, (uint16_t)value);
    put_u16(writer, (uint16_t)(value >> 16));
}

static writer_t begin(uint8_t *wire, uint8_t type)
{
    writer_t writer = {.next = wire, .crc = 0xFFFF};
    open_block(&writer);
    put_u8(&writer, type);
    return writer;
}

static uint16_t end(writer_t *writer, const uint8_t *wire)
{
    put_u16(writer, writer->crc);
    close_block(writer);
    *writer->next++ = 0;
    return (uint16_t)(writer->next - wire);
}

uint16_t frame_data(uint8_t *wire, const frame_header_t *header, const uint16_t *counts)
{
    writer_t writer = begin(wire, 'D');
    put_u8(&writer, header->flags);
    put_u16(&writer, header->sequence);
    put_u32(&writer, header->device_us);
    put_u16(&writer, header->count);
    put_u8(&writer, header->bits);
    put_u8(&writer, header->overruns);
    for (uint16_t k = 0; k < header->count; k++)
        put_u16(&writer, counts[k]);
    return end(&writer, wire);
}

uint16_t frame_info(uint8_t *wire, const frame_info_t *info)
{
    writer_t writer = begin(wire, 'I');
    put_u8(&writer, FRAME_PROTOCOL);
    put_u8(&writer, info->rows);
    put_u8(&writer, info->cols);
    put_u8(&writer, info->bits);
    put_u8(&writer, info->scan_mode);
    for (uint8_t k = 0; k < 3; k++)
        put_u8(&writer, info->firmware[k]);
    put_u16(&writer, info->rate_hz);
    put_u32(&writer, info->serial);
    put_u32(&writer, info->sense_ohm);
    put_u16(&writer, info->vref_mv);
    for (const char *next = info->layout; pgm_read_byte(next); next++)
        put_u8(&writer, (uint8_t)pgm_read_byte(next));
    return end(&writer, wire);
}

uint16_t frame_errors(uint8_t *wire, const frame_errors_t *errors)
{
    writer_t writer = begin(wire, 'E');
    put_u8(&writer, errors->reset_cause);
    put_u8(&writer, errors->bad_bytes);
    put_u8(&writer, errors->losses);
    return end(&writer, wire);
}
