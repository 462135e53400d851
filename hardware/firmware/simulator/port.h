// SPDX-License-Identifier: GPL-3.0-or-later
// The pseudo terminal that stands for the board's USB serial port.
#ifndef PORT_H
#define PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

void port_open(void);

const char *port_name(void);

// Sends what there is room for, at once; returns how many bytes that were.
size_t port_write(const uint8_t *bytes, size_t size);

// Waits up to `timeout_ms` for room to write.
void port_wait_for_room(int timeout_ms);

// Up to `size` bytes that the host has sent; 0 if there are none.
size_t port_read(uint8_t *bytes, size_t size);

// Waits until the host has taken all it was sent; gives up when `*stop` is set, and after
// a second in which it takes nothing.
void port_drain(const volatile int *stop);

#endif
