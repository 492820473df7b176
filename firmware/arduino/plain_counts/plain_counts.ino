// Prints time,left,right of two quadrature encoders: microseconds and counts since the start, 50 lines a second.
// Channels A on the interrupt pins 2 and 3 (Uno, Nano, Mega, Leonardo), channels B on 4 and 5; both edges of A count.
const byte LEFT_A = 2, LEFT_B = 4, RIGHT_A = 3, RIGHT_B = 5;
const unsigned long PERIOD_US = 20000;

volatile long left = 0, right = 0;

void countLeft() { left += digitalRead(LEFT_A) == digitalRead(LEFT_B) ? -1 : 1; }
void countRight() { right += digitalRead(RIGHT_A) == digitalRead(RIGHT_B) ? -1 : 1; }

void setup() {
  for (byte pin = LEFT_A; pin <= RIGHT_B; pin++) pinMode(pin, INPUT_PULLUP);
  attachInterrupt(digitalPinToInterrupt(LEFT_A), countLeft, CHANGE);
  attachInterrupt(digitalPinToInterrupt(RIGHT_A), countRight, CHANGE);
  Serial.begin(115200);
  Serial.println("time_us,left,right");
}

void loop() {
  static unsigned long next = 0;
  if (micros() - next < PERIOD_US) return;
  next += PERIOD_US;
  noInterrupts();  // so that both counts and the time are of one instant
  const unsigned long now = micros();
  const long leftNow = left, rightNow = right;
  interrupts();
  char line[36];
  snprintf(line, sizeof line, "%lu,%ld,%ld", now, leftNow, rightNow);
  Serial.println(line);
}
