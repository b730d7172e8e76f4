// In a field for a number: what is no number is refused at once, and the value before comes back.
(() => {
  const link = window.so101;
  const put = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
  const before = new WeakMap();  // the value that was in force when the field was entered
  const refused = new WeakSet();  // until the field is left: "1e9" must not become 19
  const isField = (node) =>
    node.tagName === 'INPUT' && ['numeric', 'decimal'].includes(node.inputMode);

  function restore(node) {
    put.call(node, before.get(node));
    node.dispatchEvent(new Event('input', { bubbles: true }));
  }

  addEventListener('focusin', ({ target }) => {
    if (isField(target)) before.set(target, target.value);
  }, true);
  addEventListener('beforeinput', (event) => {
    const { target, data } = event;
    if (!isField(target) || data === null) return;
    if (!refused.has(target) && /^[-+−\d.,\s]*$/.test(data)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (refused.has(target)) return;
    refused.add(target);
    link.tellReason?.(`"${data}" is no number. The value before stays; leave the field to enter another.`);
    restore(target);
  }, true);
  addEventListener('keydown', ({ target, key }) => {
    if (!isField(target) || !['Enter', 'Backspace', 'Delete'].includes(key)) return;
    refused.delete(target);
    if (key === 'Enter' && target.value.trim()) before.set(target, target.value);
  }, true);
  addEventListener('focusout', ({ target }) => {
    if (!isField(target)) return;
    refused.delete(target);
    if (!/\d/.test(target.value) && before.has(target)) restore(target);
  }, true);

  // A grey button of the panels in a window that only watches.
  addEventListener('pointerdown', ({ target }) => {
    const { controls, text } = link.boards.window ?? {};
    if (controls === false && target.closest?.('#root .mantine-Button-root:disabled')) {
      link.tellReason?.(text);
    }
  }, true);
})();
