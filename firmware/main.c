/* The board: serial port, timer, encoders, load cells, motor bridges. The rest is portable. */
#include <avr/interrupt.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "board.h"
#include "hx711.h"
#include "pins.h"

#define STEP_MS 4 /* of the control loop; four channels take about half of it */
#define INBOX 128
#define OUTBOX 256

static volatile uint8_t inbox[INBOX], outbox[OUTBOX];
static volatile uint8_t in_head, in_tail, out_head, out_tail;
static volatile uint32_t milliseconds;
static volatile int32_t ticks[CHANNELS];
static struct link tendons;
static struct sensors sensors[CHANNELS];

#ifdef __AVR_ATmega2560__
#define RECEIVED USART0_RX_vect
#define SENDABLE USART0_UDRE_vect
#else
#define RECEIVED USART_RX_vect
#define SENDABLE USART_UDRE_vect
#endif

ISR(RECEIVED)
{
    uint8_t byte = UDR0, next = (uint8_t)(in_head + 1) % INBOX;
    if (next != in_tail) { /* else the frame is spoilt, and its CRC says so */
        inbox[in_head] = byte;
        in_head = next;
    }
}

ISR(SENDABLE)
{
    if (out_tail == out_head)
        UCSR0B &= (uint8_t)~(1 << UDRIE0);
    else
        UDR0 = outbox[out_tail++];
}

ISR(TIMER2_COMPA_vect)
{
    milliseconds++;
}

static inline void edge(uint8_t i)
{
    bool a = PIND & ENCODER_A(i), b = ENCODER_B_PIN & ENCODER_B(i);
    ticks[i] += a == b ? 1 : -1;
}

ISR(INT0_vect)
{
    edge(0);
}

#if CHANNELS > 1
ISR(INT1_vect)
{
    edge(1);
}
#endif

#if CHANNELS > 2
ISR(INT2_vect)
{
    edge(2);
}
#endif

#if CHANNELS > 3
ISR(INT3_vect)
{
    edge(3);
}
#endif

/* After a reset by the watchdog it is still running. */
__attribute__((naked, used, section(".init3"))) void stop_watchdog(void)
{
    MCUSR = 0;
    wdt_disable();
}

/* Queue a whole frame, or nothing of it. */
static bool send(const uint8_t *bytes, uint8_t size)
{
    if ((uint8_t)(out_tail - out_head - 1) < size)
        return false;
    while (size--)
        outbox[out_head++] = *bytes++;
    UCSR0B |= 1 << UDRIE0;
    return true;
}

static void begin(void)
{
    UCSR0A = 1 << U2X0;
    UBRR0 = F_CPU / 8 / BAUD - 1;
    UCSR0B = 1 << RXEN0 | 1 << TXEN0 | 1 << RXCIE0;
    TCCR2A = 1 << WGM21;
    TCCR2B = 1 << CS22; /* 4 us */
    OCR2A = 249;
    TIMSK2 = 1 << OCIE2A;
    ADMUX = 1 << REFS0;
    ADCSRA = 1 << ADEN | 1 << ADSC | 7;
    bridge_begin();
    hx711_begin();
    ENCODER_PULL_UPS();
    ENCODER_EDGES();
    link_reset(&tendons, send);
    wdt_enable(WDTO_120MS); /* a hung program restarts with all motors off */
    sei();
}

/* One analog value per step: motor currents and the motor supply in turn. */
static void sense_analog(void)
{
    static uint8_t input;
    if (ADCSRA & 1 << ADSC)
        return;
    uint16_t value = ADC;
    if (input < CHANNELS)
        sensors[input].current = (int16_t)(value * MILLIAMPERE_PER_COUNT);
    else
        for (uint8_t i = 0; i < CHANNELS; i++)
            sensors[i].faults =
                (uint32_t)value * MILLIVOLT_PER_COUNT < LOWEST_SUPPLY ? FAULT_VOLTAGE : 0;
    input = input < CHANNELS ? input + 1 : 0;
    ADMUX = 1 << REFS0 | (input < CHANNELS ? input : SUPPLY_INPUT);
    ADCSRA |= 1 << ADSC;
}

static void sense(void)
{
    static int32_t counts[CHANNELS];
    uint8_t fresh = hx711_read(counts);
    sense_analog();
    for (uint8_t i = 0; i < CHANNELS; i++) {
        sensors[i].fresh = fresh >> i & 1;
        sensors[i].cell = counts[i];
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
        {
            sensors[i].ticks = ticks[i];
        }
    }
}

static void drive(void)
{
    for (uint8_t i = 0; i < CHANNELS; i++) {
        float duty = 255.0f * tendons.board.channels[i].duty;
        bridge_set(i, duty > 0.0f ? (uint8_t)duty : 0, duty < 0.0f ? (uint8_t)-duty : 0);
    }
}

static uint32_t now(void)
{
    uint32_t value;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        value = milliseconds;
    }
    return value;
}

int main(void)
{
    uint32_t next = STEP_MS;
    begin();
    for (;;) {
        while (in_tail != in_head) {
            uint8_t byte = inbox[in_tail];
            in_tail = (uint8_t)(in_tail + 1) % INBOX;
            link_receive(&tendons, byte);
        }
        if ((int32_t)(now() - next) < 0)
            continue;
        next += STEP_MS;
        sense();
        link_step(&tendons, sensors, 1000 * now());
        drive();
        wdt_reset();
    }
}
