/* The tension loop: tension error -> speed of the wire -> place of the wire -> duty of the motor.
 *
 * A load cell answers some 80 times a second, an encoder always: the fast inner loop holds the
 * place of the wire, the slow outer one moves that place until the tension is right. */
#include "control.h"

#define PLACE_GAIN 1000.0f /* [1/m] duty per error of place */
#define EXTRA_GAIN 4000.0f  /* [1/(m s)] */
#define LARGEST_EXTRA 0.5f  /* [1] */
#define LEAD 0.005f         /* [m] the wanted place never runs further ahead */
#define HARD 0.95f          /* [1] duty ... */
#define STILL 0.5f          /* [s] ... after so long without a tick is a fault */
#define OVERLOAD 1.5f       /* times the tension limit ... */
#define OVERLOAD_OFFSET 0.5f /* [N] ... and this much more */

static float bounded(float value, float low, float high)
{
    return value < low ? low : value > high ? high : value;
}

static float approach(float value, float goal, float step)
{
    return bounded(goal, value - step, value + step);
}

void control_reset(struct board *board)
{
    *board = (struct board){.mode = TENSION, .timeout = 0.2f, .period = 10000};
}

uint8_t control_configured(const struct board *board)
{
    return board->settings_known ? board->limits_known & board->calibration_known : 0;
}

static void stop(struct channel *channel)
{
    channel->on = false;
    channel->duty = channel->extra = 0.0f;
}

/* Start from what is measured. */
static void settle_here(struct channel *channel)
{
    channel->place = channel->pull;
    channel->goal = channel->tension > 0.0f ? channel->tension : 0.0f;
}

bool control_enable(struct board *board, uint8_t mode, uint8_t mask)
{
    for (uint8_t i = 0; i < CHANNELS; i++)
        if ((mask >> i & 1) && board->channels[i].faults)
            return false;
    if (mode != board->mode)
        control_disable(board, ALL_CHANNELS & (uint8_t)~mask);
    board->mode = mode;
    board->flags &= (uint8_t)~(FLAG_SILENCE | FLAG_RELEASED);
    board->since_command = 0.0f;
    for (uint8_t i = 0; i < CHANNELS; i++) {
        struct channel *channel = &board->channels[i];
        if (!(mask >> i & 1))
            continue;
        if (!channel->on)
            stop(channel);
        settle_here(channel);
        channel->command = mode == TENSION ? channel->goal : channel->place;
        channel->on = true;
    }
    return true;
}

void control_disable(struct board *board, uint8_t mask)
{
    for (uint8_t i = 0; i < CHANNELS; i++)
        if (mask >> i & 1)
            stop(&board->channels[i]);
}

void control_release(struct board *board, uint8_t flag, uint8_t to)
{
    if (!(board->flags & (FLAG_SILENCE | FLAG_RELEASED)))
        for (uint8_t i = 0; i < CHANNELS; i++)
            settle_here(&board->channels[i]);
    board->flags |= flag;
    board->release_to = to;
}

uint8_t control_enabled(const struct board *board)
{
    uint8_t mask = 0;
    for (uint8_t i = 0; i < CHANNELS; i++)
        mask |= (uint8_t)(board->channels[i].on << i);
    return mask;
}

static void measure(struct channel *channel, const struct sensors *sensors, float passed)
{
    channel->cell_age = sensors->fresh ? 0.0f : channel->cell_age + passed;
    channel->tension = (float)(sensors->cell - channel->zero) * channel->newton_per_count;
    channel->pull = (float)sensors->ticks * channel->metre_per_tick;
    channel->current = sensors->current;
    bool turning = sensors->ticks != channel->ticks_seen;
    bool hard = channel->duty > HARD || channel->duty < -HARD;
    channel->still = turning || !hard ? 0.0f : channel->still + passed;
    channel->ticks_seen = sensors->ticks;
}

static void watch(struct channel *channel, const struct sensors *sensors)
{
    uint16_t found = sensors->faults & (FAULT_OVERHEATING | FAULT_VOLTAGE);
    if (sensors->cell >= CELL_LIMIT || sensors->cell <= -CELL_LIMIT ||
        channel->cell_age > CELL_SILENCE)
        found |= FAULT_CELL;
    else if (channel->on && channel->tension > OVERLOAD * channel->tension_high + OVERLOAD_OFFSET)
        found |= FAULT_OVERLOAD;
    if (channel->still > STILL)
        found |= FAULT_ENCODER;
    channel->faults |= found;
    if (channel->faults)
        stop(channel);
}

/* Move the wanted place of the wire until the tension is what it should be. */
static void tension_loop(const struct board *board, struct channel *channel, float passed)
{
    float speed = board->gain * (channel->goal - channel->tension);
    channel->place += bounded(speed, -channel->pull_rate, channel->pull_rate) * passed;
}

static void drive(const struct board *board, struct channel *channel, float passed)
{
    float wanted, low = channel->pull_low, high = channel->pull_high;
    if (channel->place < low) /* a wire that is outside comes back at its rate, without a jump */
        low = channel->place;
    if (channel->place > high)
        high = channel->place;
    if (board->flags & (FLAG_SILENCE | FLAG_RELEASED)) {
        channel->goal = approach(channel->goal, board->rest, board->release_rate * passed);
        tension_loop(board, channel, passed);
    } else if (board->mode == TENSION) {
        wanted = bounded(channel->command, channel->tension_low, channel->tension_high);
        channel->goal = approach(channel->goal, wanted, channel->tension_rate * passed);
        tension_loop(board, channel, passed);
    } else {
        wanted = bounded(channel->command, channel->pull_low, channel->pull_high);
        if (channel->tension > channel->tension_high && wanted > channel->place)
            wanted = channel->place - channel->pull_rate * passed;
        channel->place = approach(channel->place, wanted, channel->pull_rate * passed);
    }
    channel->place = bounded(channel->place, channel->pull - LEAD, channel->pull + LEAD);
    channel->place = bounded(channel->place, low, high);
    float error = channel->place - channel->pull;
    channel->extra = bounded(channel->extra + EXTRA_GAIN * error * passed, -LARGEST_EXTRA,
                             LARGEST_EXTRA);
    channel->duty = bounded(PLACE_GAIN * error + channel->extra, -1.0f, 1.0f);
}

/* After a release to limp: off as soon as every tension has arrived. */
static void end_release(struct board *board)
{
    if (board->release_to != LIMP || !(board->flags & (FLAG_SILENCE | FLAG_RELEASED)))
        return;
    for (uint8_t i = 0; i < CHANNELS; i++)
        if (board->channels[i].on && board->channels[i].goal != board->rest)
            return;
    control_disable(board, ALL_CHANNELS);
}

void control_step(struct board *board, const struct sensors *sensors, float passed)
{
    if (control_configured(board))
        board->flags |= FLAG_CONFIGURED;
    board->since_command += passed;
    bool enabled = control_enabled(board) != 0;
    for (uint8_t i = 0; i < CHANNELS; i++) {
        measure(&board->channels[i], &sensors[i], passed);
        watch(&board->channels[i], &sensors[i]);
    }
    if (enabled && board->since_command > board->timeout &&
        !(board->flags & (FLAG_SILENCE | FLAG_RELEASED)))
        control_release(board, FLAG_SILENCE, board->release_to);
    for (uint8_t i = 0; i < CHANNELS; i++)
        if (board->channels[i].on)
            drive(board, &board->channels[i], passed);
    end_release(board);
}
