/* Messages to the board are checked whole before anything of them is applied. */
#include "board.h"

#define MICRO 1e-6f

static void tell(struct link *link, uint8_t type, const uint8_t *payload, uint8_t length)
{
    uint8_t bytes[MAX_FRAME];
    uint8_t size = frame_encode(type, link->sequence, payload, length, bytes);
    if (link->send(bytes, size))
        link->sequence++;
}

static uint8_t apply_command(struct link *link, const uint8_t *payload)
{
    struct board *board = &link->board;
    if (payload[0] > PULL || payload[0] != board->mode)
        return WRONG_VALUE;
    for (uint8_t i = 0; i < CHANNELS; i++)
        board->channels[i].command = MICRO * (float)get32(payload + 1 + 4 * i);
    board->since_command = 0.0f;
    if (board->flags & (FLAG_SILENCE | FLAG_RELEASED))
        for (uint8_t i = 0; i < CHANNELS; i++) /* go on from here, at the usual rates */
            board->channels[i].goal =
                board->channels[i].tension > 0.0f ? board->channels[i].tension : 0.0f;
    board->flags &= (uint8_t)~(FLAG_SILENCE | FLAG_RELEASED);
    link->command_sequence = link->frame.sequence;
    return DONE;
}

static uint8_t apply_limits(struct board *board, const uint8_t *payload)
{
    float values[6];
    if (payload[0] >= CHANNELS)
        return WRONG_VALUE;
    for (uint8_t i = 0; i < 6; i++)
        values[i] = MICRO * (float)get32(payload + 1 + 4 * i);
    if (values[0] < 0.0f || values[0] >= values[1] || values[2] >= values[3] ||
        values[4] <= 0.0f || values[5] <= 0.0f)
        return WRONG_VALUE;
    struct channel *channel = &board->channels[payload[0]];
    channel->tension_low = values[0];
    channel->tension_high = values[1];
    channel->pull_low = values[2];
    channel->pull_high = values[3];
    channel->tension_rate = values[4];
    channel->pull_rate = values[5];
    board->limits_known |= (uint8_t)(1u << payload[0]);
    return DONE;
}

static uint8_t apply_calibration(struct board *board, const uint8_t *payload)
{
    if (payload[0] >= CHANNELS || control_enabled(board) >> payload[0] & 1)
        return WRONG_VALUE;
    int32_t scale = get32(payload + 5), turn = get32(payload + 9);
    if (scale == 0 || turn == 0)
        return WRONG_VALUE;
    struct channel *channel = &board->channels[payload[0]];
    channel->zero = get32(payload + 1);
    channel->newton_per_count = 1e-12f * (float)scale;
    channel->metre_per_tick = 1e-9f * (float)turn;
    board->calibration_known |= (uint8_t)(1u << payload[0]);
    return DONE;
}

static uint8_t apply_settings(struct board *board, const uint8_t *payload)
{
    uint16_t timeout = get16(payload), period = get16(payload + 3);
    int32_t rate = get32(payload + 5), rest = get32(payload + 9), gain = get32(payload + 13);
    if (timeout < 10 || payload[2] > LIMP || period < 1000 || rate <= 0 || rest < 0 || gain <= 0)
        return WRONG_VALUE;
    board->timeout = 1e-3f * (float)timeout;
    board->release_to = payload[2];
    board->period = period;
    board->release_rate = MICRO * (float)rate;
    board->rest = MICRO * (float)rest;
    board->gain = 1e-9f * (float)gain;
    board->settings_known = true;
    return DONE;
}

static uint8_t apply_enable(struct board *board, const uint8_t *payload)
{
    if (payload[0] > PULL || payload[1] & (uint8_t)~ALL_CHANNELS)
        return WRONG_VALUE;
    if (payload[1] & (uint8_t)~control_configured(board))
        return NOT_CONFIGURED;
    return control_enable(board, payload[0], payload[1]) ? DONE : FAULT_LATCHED;
}

static uint8_t apply(struct link *link)
{
    struct board *board = &link->board;
    const uint8_t *payload = link->frame.payload;
    switch (link->frame.type) {
    case COMMAND:
        return apply_command(link, payload);
    case ENABLE:
        return apply_enable(board, payload);
    case DISABLE:
        control_disable(board, payload[0]);
        return DONE;
    case RELEASE:
        if (payload[0] > LIMP)
            return WRONG_VALUE;
        control_release(board, FLAG_RELEASED, payload[0]);
        return DONE;
    case LIMITS:
        return apply_limits(board, payload);
    case CALIBRATION:
        return apply_calibration(board, payload);
    case SETTINGS:
        return apply_settings(board, payload);
    case CLEAR:
        for (uint8_t i = 0; i < CHANNELS; i++)
            if (payload[0] >> i & 1)
                board->channels[i].faults = 0;
        return DONE;
    default:
        return UNKNOWN_TYPE;
    }
}

static void tell_identity(struct link *link)
{
    uint8_t payload[8] = {PROTOCOL_VERSION, CHANNELS};
    put16(payload + 2, FIRMWARE_VERSION);
    put32(payload + 4, link->now);
    tell(link, IDENTITY, payload, sizeof payload);
}

static void tell_cells(struct link *link)
{
    uint8_t payload[4 + 4 * CHANNELS];
    put32(payload, link->now);
    for (uint8_t i = 0; i < CHANNELS; i++)
        put32(payload + 4 + 4 * i, (uint32_t)link->cells[i]);
    tell(link, RAW_CELLS, payload, sizeof payload);
}

static void tell_state(struct link *link)
{
    uint8_t payload[TELEMETRY_HEADER + TELEMETRY_CHANNEL * CHANNELS];
    put32(payload, link->now);
    payload[4] = link->board.flags;
    payload[5] = control_enabled(&link->board);
    payload[6] = link->board.mode;
    payload[7] = link->command_sequence;
    put16(payload + 8, link->receiver.bad);
    for (uint8_t i = 0; i < CHANNELS; i++) {
        const struct channel *channel = &link->board.channels[i];
        uint8_t *at = payload + TELEMETRY_HEADER + TELEMETRY_CHANNEL * i;
        put32(at, (uint32_t)(int32_t)(1e6f * channel->tension));
        put32(at + 4, (uint32_t)(int32_t)(1e6f * channel->pull));
        put16(at + 8, (uint16_t)channel->current);
        put16(at + 10, channel->faults);
    }
    tell(link, TELEMETRY, payload, sizeof payload);
}

static void obey(struct link *link)
{
    const struct frame *frame = &link->frame;
    if (frame->type == HELLO) { /* of any version: it is how versions are told */
        link->silent = 0.0f;
        tell_identity(link);
        return;
    }
    if (frame->version != PROTOCOL_VERSION || frame->type >= IDENTITY)
        return;
    link->silent = 0.0f;
    int size = payload_size(frame->type);
    if (size == frame->length && frame->type == RAW) {
        tell_cells(link);
        return;
    }
    if (size == frame->length && frame->type == HEARTBEAT)
        return;
    uint8_t code = size < 0 ? UNKNOWN_TYPE : size != frame->length ? WRONG_LENGTH : apply(link);
    if (frame->type == COMMAND && code == DONE)
        return; /* telemetry carries its sequence number */
    const uint8_t payload[3] = {frame->type, frame->sequence, code};
    tell(link, RESULT, payload, sizeof payload);
}

void link_reset(struct link *link, bool (*send)(const uint8_t *bytes, uint8_t size))
{
    *link = (struct link){.send = send, .silent = LINK_SILENCE};
    control_reset(&link->board);
}

void link_receive(struct link *link, uint8_t byte)
{
    if (receiver_feed(&link->receiver, byte, &link->frame))
        obey(link);
}

void link_step(struct link *link, const struct sensors *sensors, uint32_t now)
{
    float passed = MICRO * (float)(now - link->now);
    link->now = now;
    if (link->silent < LINK_SILENCE)
        link->silent += passed;
    for (uint8_t i = 0; i < CHANNELS; i++)
        link->cells[i] = sensors[i].cell;
    control_step(&link->board, sensors, passed);
    if (link->silent < LINK_SILENCE && now - link->told >= link->board.period) {
        link->told = now;
        tell_state(link);
    }
}
