/* Frames: consistent overhead byte stuffing, then a CRC over the stuffed bytes, then a zero. */
#include "protocol.h"

#define CRC_BYTES 3

uint16_t crc16(const uint8_t *bytes, uint8_t size)
{
    uint16_t crc = 0xFFFF;
    while (size--) {
        crc = (uint16_t)(crc >> 8) | (uint16_t)(crc << 8);
        crc ^= *bytes++;
        crc ^= (uint8_t)(crc & 0xFF) >> 4;
        crc ^= (uint16_t)(crc << 12);
        crc ^= (uint16_t)((crc & 0xFF) << 5);
    }
    return crc;
}

/* Six bits per byte with the highest bit set: a CRC never looks like a delimiter. */
static void put_crc(uint8_t *at, uint16_t crc)
{
    at[0] = 0x80 | (uint8_t)(crc >> 12);
    at[1] = 0x80 | (uint8_t)((crc >> 6) & 0x3F);
    at[2] = 0x80 | (uint8_t)(crc & 0x3F);
}

uint8_t frame_encode(uint8_t type, uint8_t sequence, const uint8_t *payload, uint8_t length,
                     uint8_t *out)
{
    const uint8_t header[HEADER_SIZE] = {PROTOCOL_VERSION, type, sequence, length};
    uint8_t code_at = 0, size = 1;
    for (uint8_t i = 0; i < HEADER_SIZE + length; i++) {
        uint8_t byte = i < HEADER_SIZE ? header[i] : payload[i - HEADER_SIZE];
        if (byte == 0) {
            out[code_at] = size - code_at;
            code_at = size++;
        } else {
            out[size++] = byte;
        }
    }
    out[code_at] = size - code_at;
    put_crc(out + size, crc16(out, size));
    out[size + CRC_BYTES] = 0;
    return size + CRC_BYTES + 1;
}

bool frame_decode(const uint8_t *bytes, uint8_t size, struct frame *frame)
{
    uint8_t crc[CRC_BYTES], body[HEADER_SIZE + MAX_PAYLOAD];
    if (size < HEADER_SIZE + 1 + CRC_BYTES || size > MAX_FRAME - 1)
        return false;
    size -= CRC_BYTES;
    put_crc(crc, crc16(bytes, size));
    for (uint8_t i = 0; i < CRC_BYTES; i++)
        if (crc[i] != bytes[size + i])
            return false;
    uint8_t next = bytes[0]; /* where the next stuffed zero stands */
    if (next == 0)
        return false;
    for (uint8_t i = 1; i < size; i++) {
        if (bytes[i] == 0)
            return false;
        body[i - 1] = i == next ? 0 : bytes[i];
        if (i == next) {
            if (next + bytes[i] > size)
                return false;
            next += bytes[i];
        }
    }
    if (next != size || body[3] != size - 1 - HEADER_SIZE)
        return false;
    frame->version = body[0];
    frame->type = body[1];
    frame->sequence = body[2];
    frame->length = body[3];
    for (uint8_t i = 0; i < frame->length; i++)
        frame->payload[i] = body[HEADER_SIZE + i];
    return true;
}

bool receiver_feed(struct receiver *receiver, uint8_t byte, struct frame *frame)
{
    if (byte != 0) {
        if (receiver->size < MAX_FRAME)
            receiver->bytes[receiver->size++] = byte;
        else
            receiver->too_long = true;
        return false;
    }
    bool any = receiver->size > 0;
    bool good = any && !receiver->too_long && frame_decode(receiver->bytes, receiver->size, frame);
    receiver->bad += any && !good;
    receiver->size = 0;
    receiver->too_long = false;
    return good;
}

int payload_size(uint8_t type)
{
    switch (type) {
    case HELLO:
    case RAW:
    case HEARTBEAT:
        return 0;
    case COMMAND:
        return 1 + 4 * CHANNELS;
    case ENABLE:
        return 2;
    case DISABLE:
    case RELEASE:
    case CLEAR:
        return 1;
    case LIMITS:
        return 25;
    case CALIBRATION:
        return 13;
    case SETTINGS:
        return 17;
    default:
        return -1;
    }
}

void put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
}

void put32(uint8_t *at, uint32_t value)
{
    put16(at, (uint16_t)value);
    put16(at + 2, (uint16_t)(value >> 16));
}

uint16_t get16(const uint8_t *at)
{
    return (uint16_t)(at[0] | (uint16_t)at[1] << 8);
}

int32_t get32(const uint8_t *at)
{
    return (int32_t)((uint32_t)get16(at) | (uint32_t)get16(at + 2) << 16);
}
