/* Frames between computer and board; the bytes are documented in docs/serial_protocol.md.
 *
 * Plain C99, no library, no dynamic memory: the same file runs on the board and on a computer. */
#ifndef TENDON_PROTOCOL_H
#define TENDON_PROTOCOL_H

#include <stdbool.h>
#include <stdint.h>

#ifndef CHANNELS
#define CHANNELS 4 /* tendons of this board, 1 to 8 */
#endif

#define PROTOCOL_VERSION 1
#define HEADER_SIZE 4 /* version, type, sequence, length of the payload */
#define TELEMETRY_HEADER 10
#define TELEMETRY_CHANNEL 12
#define MAX_PAYLOAD                                                                               \
    (TELEMETRY_HEADER + TELEMETRY_CHANNEL * CHANNELS > 25                                         \
         ? TELEMETRY_HEADER + TELEMETRY_CHANNEL * CHANNELS                                        \
         : 25)
#define MAX_FRAME (HEADER_SIZE + MAX_PAYLOAD + 5) /* one byte of stuffing, 3 of CRC, delimiter */

enum message {
    /* computer -> board */
    HELLO = 0x01,
    COMMAND = 0x02,
    ENABLE = 0x03,
    DISABLE = 0x04,
    RELEASE = 0x05,
    LIMITS = 0x06,
    CALIBRATION = 0x07,
    SETTINGS = 0x08,
    CLEAR = 0x09,
    RAW = 0x0A,
    HEARTBEAT = 0x0B,
    /* board -> computer */
    IDENTITY = 0x81,
    TELEMETRY = 0x82,
    RAW_CELLS = 0x83,
    RESULT = 0x84
};

struct frame {
    uint8_t version, type, sequence, length;
    uint8_t payload[MAX_PAYLOAD];
};

/* Collects bytes until a delimiter; only whole, unspoilt frames come out. */
struct receiver {
    uint8_t bytes[MAX_FRAME];
    uint8_t size;
    bool too_long;
    uint16_t bad; /* frames thrown away since the start */
};

/* CRC-16/CCITT-FALSE (IBM-3740): polynomial 0x1021, start 0xFFFF; "123456789" gives 0x29B1. */
uint16_t crc16(const uint8_t *bytes, uint8_t size);

/* Build a frame; returns the number of bytes written to out, which holds MAX_FRAME. */
uint8_t frame_encode(uint8_t type, uint8_t sequence, const uint8_t *payload, uint8_t length,
                     uint8_t *out);

/* Read the bytes between two delimiters; false when anything about them is wrong. */
bool frame_decode(const uint8_t *bytes, uint8_t size, struct frame *frame);

/* Take one byte; true when it completed a good frame. */
bool receiver_feed(struct receiver *receiver, uint8_t byte, struct frame *frame);

/* Payload size that a message to the board must have, -1 for an unknown type. */
int payload_size(uint8_t type);

/* Little-endian integers. */
void put16(uint8_t *at, uint16_t value);
void put32(uint8_t *at, uint32_t value);
uint16_t get16(const uint8_t *at);
int32_t get32(const uint8_t *at);

#endif
